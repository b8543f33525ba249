"""Who publishes a key: one session, and whoever comes beside it is kept apart.

Every put carries its publisher's session, and nodes announce theirs (a liveliness token that is
gone when the process is). The publisher of a key is the session that published it first; another
one beside it is a second source: processors do not use it, the recorder writes it under a topic of
its own (`keys.apart`). So does it with messages without our header.

When the session of a key changes, the node may have been started again, or two publish:

    same session ──────────────────────────────▶ used
    another one, the first is not announced,
        and this one is ───────────────────────▶ used: it follows the first
    another one, announced before the first ───▶ used: so say all readers, whoever heard whom first
    anything else is in doubt ─────────────────▶ held
        the first publishes again ─────────────▶ apart
        nothing of the first for `WAIT_S` ─────▶ apart if the first is announced, else used
    apart, and the first not announced and
        silent for `QUIET_S` ──────────────────▶ used from here on

Tokens are asked for at the reader's start, and then only while somebody is in doubt or apart. One
that was not there the last time is no older than that, whatever it says. Messages that are held go
on in their order; nothing is dropped for having come before its token.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from tramstream import keys
from tramstream.clock import S
from tramstream.transport.bus import Envelope
from tramstream.transport.tokens import Announced

WAIT_S = 0.5
"""So long a session may be in doubt: tokens go within milliseconds, and a key of the slowest
sensor that matters (5 Hz) has spoken twice."""
QUIET_S = 1.0
"""A session that was apart follows from this long after the first one's last message: all readers
agree which message that is, for all know by then that the first is gone."""
ASK_S = 0.1
"""Tokens are as old as this."""
HELD_BYTES = 16 << 20
"""Held on one key; what comes then is apart."""
MOST_RIVALS = 8
"""Sessions that are told apart on one key, beside announced ones; others share a topic."""
MOST_TOPICS = 2000
"""Remembered; of further ones, which somebody makes up, only those of announced sessions are."""
SINCE_KEPT = 1024
"""Sessions whose beginning is remembered."""
FORGOTTEN_S = 10.0
"""A session that was silent so long is no longer looked for."""
NOBODY = 0
"""Session of messages without our header."""
OTHERS = 0xFFFFFFFF
"""Session that stands for all beyond `MOST_RIVALS`."""


@dataclass(slots=True)
class _Rival:
    """A session beside the first."""

    first_ns: int
    last_ns: int
    apart: bool = False
    held: list[Envelope] = field(default_factory=list)
    held_bytes: int = 0


@dataclass(slots=True)
class Source:
    """Who publishes one topic. `last_ns` is the publication of the newest message of `session`."""

    session: int
    last_ns: int
    rivals: dict[int, _Rival] = field(default_factory=dict)


class Sources:
    """Judges the messages of one node.

    Parameters
    ----------
    ask : callable
        Gives who is announced now; blocks until it is known.
    """

    def __init__(self, ask: Callable[[], list[Announced]]) -> None:
        self.by_topic: dict[str, Source] = {}
        self.contested: set[str] = set()
        """Topics that have a session in doubt or apart."""
        self._ask = ask
        self._asked_ns = 0
        self._since_ns: dict[int, int] = {}  # of announced sessions
        self._first_since_ns: dict[int, int] = {}  # of all that were
        self._names: dict[int, str] = {}

    def name(self, session: int) -> str:
        """A session for people."""
        if session == NOBODY:
            return "a stranger without our header"
        known = self._names.get(session)
        return f"{known} (session {session:08x})" if known else f"session {session:08x}"

    def know(self, now_ns: int) -> None:
        """Take note of who is announced at the reader's start: nobody else is older."""
        self._tokens(now_ns)

    def is_announced(self, session: int, now_ns: int) -> bool:
        """Whether a node has announced itself under `session`."""
        return session in self._tokens(now_ns)

    def judge(self, envelope: Envelope, now_ns: int) -> list[Envelope]:
        """Messages to go on with now: this one, some that were held, or none as yet.

        Those that are apart have their topic changed to one of their own.
        """
        topic, session = envelope.topic, envelope.session
        if session == NOBODY or envelope.sequence == 0 or keys.is_apart(topic):
            return [_apart(envelope, NOBODY)]
        source = self.by_topic.get(topic)
        if source is None:
            if len(self.by_topic) >= MOST_TOPICS and not self.is_announced(session, now_ns):
                return [_apart(envelope, OTHERS)]
            self.by_topic[topic] = Source(session, envelope.publish_ns)
            return [envelope]
        if session == source.session:
            source.last_ns = max(source.last_ns, envelope.publish_ns)
            return [*self._first_spoke(source), envelope]
        rival = source.rivals.get(session)
        if rival is None:
            if len(source.rivals) >= MOST_RIVALS and session not in self._tokens(now_ns):
                return [_apart(envelope, OTHERS)]
            rival = source.rivals[session] = _Rival(now_ns, now_ns)
            self.contested.add(topic)
        rival.last_ns = now_ns
        if rival.apart:
            quiet = envelope.publish_ns > source.last_ns + QUIET_S * S
            if quiet and source.session not in self._tokens(now_ns):
                return self._follow(topic, source, session, [envelope])
            return [_apart(envelope, session)]
        rival.held.append(envelope)
        rival.held_bytes += len(envelope.payload)
        return self._settle(topic, source, session, now_ns)

    def place(self, envelope: Envelope) -> Envelope:
        """A message that was sent once more, with the others of its publisher; never in doubt."""
        source = self.by_topic.get(envelope.topic)
        rival = source.rivals.get(envelope.session) if source is not None else None
        return _apart(envelope, envelope.session) if rival is not None and rival.apart else envelope

    def settle(self, now_ns: int, at_end: bool = False) -> list[Envelope]:
        """Decide what has been in doubt for long enough, `at_end` all; the messages to go on with.

        Also forgets sessions that are gone.
        """
        ready: list[Envelope] = []
        for topic in list(self.contested):
            source = self.by_topic[topic]
            for session, rival in list(source.rivals.items()):
                if rival.held:
                    ready += self._settle(topic, source, session, now_ns, at_end)
                elif now_ns - rival.last_ns > FORGOTTEN_S * S:
                    source.rivals.pop(session, None)
            if not source.rivals:
                self.contested.discard(topic)
        return ready

    def _settle(
        self, topic: str, source: Source, session: int, now_ns: int, at_end: bool = False
    ) -> list[Envelope]:
        """Decide about a session in doubt if that can be done; its messages if it could."""
        rival = source.rivals.get(session)
        if rival is None or not rival.held:
            return []
        tokens = self._tokens(now_ns)
        first, other = tokens.get(source.session), tokens.get(session)
        if other is not None and (first is None or other < first):
            return self._follow(topic, source, session, rival.held)
        beside = rival.held[0].publish_ns <= source.last_ns or rival.held_bytes > HELD_BYTES
        if beside:
            return _release(rival, session)
        if at_end or now_ns - rival.first_ns >= WAIT_S * S:
            if first is not None:
                return _release(rival, session)
            return self._follow(topic, source, session, rival.held)
        return []

    def _first_spoke(self, source: Source) -> list[Envelope]:
        """The first session publishes still: whoever was in doubt is apart."""
        released: list[Envelope] = []
        for session, rival in source.rivals.items():
            if not rival.apart:
                released += _release(rival, session)
        return released

    def _follow(
        self, topic: str, source: Source, session: int, ready: list[Envelope]
    ) -> list[Envelope]:
        """`session` publishes the topic from now on; others in doubt stay so."""
        del source.rivals[session]
        source.session, source.last_ns = session, ready[-1].publish_ns
        if not source.rivals:
            self.contested.discard(topic)
        return ready

    def _tokens(self, now_ns: int) -> dict[int, int]:
        """Announced sessions and since when, no older than `ASK_S`."""
        if not self._asked_ns or now_ns - self._asked_ns >= ASK_S * S:
            found, before_ns = self._ask(), self._asked_ns
            self._asked_ns = now_ns
            self._since_ns = {}
            for each in found:
                since_ns = self._first_since_ns.setdefault(
                    each.session, max(each.since_ns, before_ns)
                )
                self._since_ns[each.session] = since_ns
                self._names[each.session] = keys.split(each.topic)[1].split("/")[1]
            while len(self._first_since_ns) > SINCE_KEPT:
                gone = next(iter(self._first_since_ns))
                del self._first_since_ns[gone]
                self._names.pop(gone, None)
        return self._since_ns


def _release(rival: _Rival, session: int) -> list[Envelope]:
    """The session is apart from now on; what was held of it."""
    rival.apart = True
    released = [_apart(envelope, session) for envelope in rival.held]
    rival.held.clear()
    rival.held_bytes = 0
    return released


def _apart(envelope: Envelope, session: int) -> Envelope:
    return envelope._replace(topic=keys.apart(envelope.topic, session))
