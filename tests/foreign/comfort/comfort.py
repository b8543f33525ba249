from dataclasses import dataclass

from msgspec import Struct

from tramstream import events, keys
from tramstream.processor import Processor
from tramstream.proto.define import message

Push = message("comfort.Push", horizontal_mps2=float, uncomfortable=bool)
PUSH = keys.define("est/comfort/push", Push, 2, "interval's end", "How hard passengers are pushed")
HARD = events.define("comfort.hard", "a push of {push_mps2}", cure="brake softer", push_mps2=float)


class Comfort(Processor):
    name, inputs, outputs, events = "comfort", (keys.SYNC_IMU,), (PUSH,), (HARD,)

    class Settings(Struct, frozen=True):
        limit_mps2: float = 1.2
        """Horizontal specific force above which who stands needs a hand, m/s²."""

    @dataclass
    class Memory:
        push_mps2: float = 0.0
        until_ns: int = 0

    def step(self, sample):
        mean, kept = sample.message, self.memory
        kept.push_mps2 = max(kept.push_mps2, abs(complex(mean.accel_x_mps2, mean.accel_y_mps2)))
        if sample.stamp_ns < kept.until_ns:
            return []
        push, kept.push_mps2, kept.until_ns = kept.push_mps2, 0.0, sample.stamp_ns + int(5e8)
        said = Push(horizontal_mps2=push, uncomfortable=push > self.settings.limit_mps2)
        told = self.raise_event(HARD(push_mps2=push), sample.stamp_ns) if said.uncomfortable else []
        return [self.emit(PUSH, said, sample.stamp_ns), *told]
