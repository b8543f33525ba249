"""What the nodes of a vehicle have to say: heard by its supervisor, told to people."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from foxglove_schemas_protobuf.Log_pb2 import Log

from tramstream import keys
from tramstream.boundary import Undecodable, decode
from tramstream.events.messages import identity_of
from tramstream.keys import Key
from tramstream.proto.health_pb2 import Loss, NodeHealth
from tramstream.supervision.budget import Budget
from tramstream.supervision.events import LEFT_OUT, NOT_BELIEVED
from tramstream.transport.bus import Bus, Envelope
from tramstream.transport.ring import Ring

RING_CAPACITY = 1000
STATES_KEPT = 256
"""Nodes whose state is remembered: a stranger may make up any number of names."""
AGAIN_S = 10.0
"""What cannot be decoded is said so often."""
RECORDER = "recorder"
SUPERVISOR = "supervisor"
"""Source of the supervisor's own events."""
KNOW_S = 0.2
"""How often is asked who the recorder is: one that is started at the end lives for seconds."""
SESSIONS_KEPT = 256
"""Of recorders, one after the other."""


class Listener(Protocol):
    """Who wants to know how the nodes are doing: the supervisor."""

    def heard(self, name: str, pid: int) -> None:
        """A heartbeat of node `name` from process `pid`."""

    def lose(self, count: int) -> None:
        """So many messages are missing in the record."""


class Voice:
    """Tells people what nodes log and when their state changes; each sentence once.

    No node says more lines a minute than its budget has, whatever happens to it (`budget.py`).

    Heartbeats, losses and sentences have a queue each: a flood of one drowns no other. Anybody may
    publish on these keys; what is no message of theirs is counted, said and left out. Losses count
    only if the session that is announced as the recorder's tells them.

    Parameters
    ----------
    bus : Bus
    vehicle : str
    say : callable
        Takes one sentence for people.
    listener : Listener
    now_s : callable
        Monotonic seconds.
    """

    def __init__(
        self,
        bus: Bus,
        vehicle: str,
        say: Callable[[str], None],
        listener: Listener,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.left_out = 0
        """Messages that could not be decoded."""
        self.strange = 0
        """Losses that somebody else told in the recorder's name."""
        self._bus = bus
        self._recorder = keys.alive(vehicle, RECORDER)
        self._recorders: dict[int, None] = {}  # sessions, in the order in which they came
        self._known_s = -KNOW_S
        self._say_line = say
        self._budget = Budget(now_s)
        self._listener = listener
        self._now_s = now_s
        self._told_s = -AGAIN_S
        self._troubles: dict[str, tuple[tuple[str, ...], ...]] = {}
        self._rings: dict[str, tuple[Key, Ring[Envelope]]] = {}
        for key in (keys.HEARTBEAT, keys.LOSS, keys.LOG):
            ring: Ring[Envelope] = Ring(RING_CAPACITY)
            self._rings[key.path] = key, ring
            bus.subscribe(key.on(vehicle), _putter(ring))

    def speak(self) -> None:
        """Say what has come."""
        if self._now_s() - self._known_s >= KNOW_S:
            self._know_recorder()
        for key, ring in self._rings.values():
            for _ in range(len(ring)):  # what comes meanwhile has its turn later
                envelope = ring.get(0.0)
                if envelope is not None:
                    self._hear(key, envelope)

    def _hear(self, key: Key, envelope: Envelope) -> None:
        path = keys.split(envelope.topic)[1]
        message = decode(key.type, envelope.payload, path)
        node = path.split("/")[1]
        if isinstance(message, Undecodable):
            self._leave_out(message)
        elif isinstance(message, Log):
            if node != SUPERVISOR and message.level != Log.Level.DEBUG:  # it speaks for itself
                self._say(node, f"{message.name}: {message.message}")
        elif isinstance(message, NodeHealth):
            self._listener.heard(node, message.pid)
            self._tell_state(node, message)
        elif isinstance(message, Loss) and node == message.consumer == RECORDER:
            self._take_loss(envelope.session, message.count)

    def _know_recorder(self) -> None:
        """Take note of the session that is announced as the recorder's, the first if several are.

        Its last words may be heard when it is no longer announced.
        """
        self._known_s = self._now_s()
        announced = self._bus.announced(self._recorder)
        if announced:
            self._recorders[announced[0].session] = None
            if len(self._recorders) > SESSIONS_KEPT:
                del self._recorders[next(iter(self._recorders))]

    def _take_loss(self, session: int, count: int) -> None:
        if session in self._recorders:
            self._listener.lose(count)
            return
        self.strange += 1
        if self.strange == 1:
            self._say_line(str(NOT_BELIEVED(session=f"{session:08x}")))

    def _tell_state(self, node: str, message: NodeHealth) -> None:
        """Say what is wrong with a node when that has changed: other kinds, or of other things."""
        kinds = tuple(identity_of(trouble) for trouble in message.troubles)
        if not kinds and message.text:
            kinds = ((message.text,),)  # of a program that knows no events
        if kinds == self._troubles.get(node, ()):
            return
        text = f"{node}: {message.text or 'all is well again'}"
        if not self._say(node, text, counted=False):
            return  # with a later heartbeat, if it is still so
        if len(self._troubles) >= STATES_KEPT:
            self._troubles.clear()
        self._troubles[node] = kinds

    def _say(self, source: str, text: str, *, counted: bool = True) -> bool:
        """Say a line of a node, if it has any left; whether it was said."""
        unsaid = self._budget.spend(source, counted=counted)
        if unsaid is None:
            return False
        self._say_line(f"{text} (and {unsaid} more lines)" if unsaid else text)
        return True

    def _leave_out(self, message: Undecodable) -> None:
        self.left_out += 1
        now_s = self._now_s()
        if now_s - self._told_s >= AGAIN_S:
            self._told_s = now_s
            key, size_bytes, reason = message
            left_out = {"reason": reason, "left_out": self.left_out}
            self._say_line(str(LEFT_OUT(key=key, size_bytes=size_bytes, **left_out)))


def _putter(ring: Ring[Envelope]) -> Callable[[Envelope], None]:
    return lambda envelope: ring.put(envelope.topic, envelope)
