from dataclasses import dataclass
from math import hypot

from msgspec import Struct

from tramstream import keys
from tramstream.processor import Processor
from tramstream.proto.define import message

Push = message("comfort.Push", horizontal_mps2=float, uncomfortable=bool)
PUSH = keys.define("est/comfort/push", Push, 2, "interval's end", "How hard passengers are pushed")


class Settings(Struct, frozen=True):
    limit_mps2: float = 1.2
    """Horizontal specific force above which who stands needs a hand, m/s²."""


@dataclass
class Memory:
    largest_mps2: float = 0.0
    until_ns: int = 0


class Comfort(Processor):
    name, inputs, outputs = "comfort", (keys.SYNC_IMU,), (PUSH,)
    Settings, Memory = Settings, Memory

    def step(self, sample):
        mean, memory = sample.message, self.memory
        memory.largest_mps2 = max(memory.largest_mps2, hypot(mean.accel_x_mps2, mean.accel_y_mps2))
        if sample.stamp_ns < memory.until_ns:
            return []
        push = memory.largest_mps2
        memory.largest_mps2, memory.until_ns = 0.0, sample.stamp_ns + 500_000_000
        said = Push(horizontal_mps2=push, uncomfortable=push > self.settings.limit_mps2)
        return [self.emit(PUSH, said, sample.stamp_ns)]
