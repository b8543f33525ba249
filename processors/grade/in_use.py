"""Which inputs tell of the slope now, and what is said when one falls silent."""

from __future__ import annotations

from dataclasses import dataclass, field

from tramstream.clock import S
from tramstream.events.kinds import Event
from tramstream.processors.grade.events import INPUT_BACK, INPUT_LOST

ACCELEROMETER, ODOMETRY, GNSS_VELOCITY, GNSS_HEIGHT, MOTOR_FORCE, MAP = (
    "accelerometer",
    "odometry",
    "gnss_velocity",
    "gnss_height",
    "motor_force",
    "map",
)
USED_S = {
    ACCELEROMETER: 0.5,
    ODOMETRY: 0.5,
    GNSS_VELOCITY: 2.5,
    GNSS_HEIGHT: 2.5,
    MOTOR_FORCE: 0.5,
    MAP: 60.0,
}
"""How long an input counts as in use; the accelerometer comes through the localiser's pitch, and
the map through the localiser too, which takes a slope once a metre and stands at stops."""
SAID_S = {ACCELEROMETER: 5.0, ODOMETRY: 5.0, GNSS_VELOCITY: 60.0, GNSS_HEIGHT: 60.0}
"""After so long a silence it is said. A tunnel is no loss of fixes; the motor force is not used
while standing, and the map not everywhere."""
ORDER = tuple(USED_S)


@dataclass
class InUseMemory:
    """What an `InUse` remembers."""

    last_ns: dict[str, int] = field(default_factory=dict)
    """When each was used last."""
    lost: list[str] = field(default_factory=list)
    """Of which it has been said that they are silent."""


class InUse:
    """Inputs and when they were used."""

    def __init__(self, memory: InUseMemory) -> None:
        self.memory = memory
        self._names: tuple[str, ...] = ()
        self._until_ns = 0
        """Before this instant `_names` can change by a use of another input alone."""

    def use(self, name: str, stamp_ns: int) -> None:
        """Take note that an input has told something."""
        self.memory.last_ns[name] = stamp_ns
        if name not in self._names:
            self._until_ns = 0

    def forget(self) -> None:
        """Memory was put back."""
        self._until_ns = 0

    def names(self, stamp_ns: int) -> tuple[str, ...]:
        """Give those in use, in a fixed order."""
        if stamp_ns >= self._until_ns:
            last = self.memory.last_ns
            ends = {name: last[name] + int(USED_S[name] * S) for name in ORDER if name in last}
            self._names = tuple(name for name, end in ends.items() if stamp_ns <= end)
            # They go on at least so long, whatever comes.
            self._until_ns = min((ends[name] + 1 for name in self._names), default=stamp_ns)
        return self._names

    def silent(self, stamp_ns: int) -> list[Event]:
        """Give what is to be said of inputs that fell silent, or came back; once a second."""
        last, lost = self.memory.last_ns, self.memory.lost
        found: list[Event] = []
        for name, limit_s in SAID_S.items():
            if name not in last:
                continue
            silent_s = (stamp_ns - last[name]) / S
            if silent_s > limit_s and name not in lost:
                lost.append(name)
                found.append(INPUT_LOST(input=name, silent_s=silent_s, limit_s=limit_s))
            elif silent_s <= limit_s and name in lost:
                lost.remove(name)
                found.append(INPUT_BACK(input=name))
        return found
