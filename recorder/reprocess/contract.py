"""What every processor keeps, as tests: subclass `ProcessorContract` in the tests of yours.

    class TestComfort(ProcessorContract):
        def make(self) -> list[Processor]:
            return [Resampler(VEHICLE), Comfort(VEHICLE)]

        def samples(self) -> Iterable[Sample]:
            return Simulation(built_in_line(), scenario.load("city"), 1, duration_s=20).samples()

pytest then finds the tests below. They need nothing but the processors and a ride.
"""

from __future__ import annotations

import random
from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path

from tramstream import keys
from tramstream.boundary import decode
from tramstream.events.messages import facts_of
from tramstream.graph import Graph
from tramstream.live import snapshots
from tramstream.processor import Processor, Sample
from tramstream.proto.health_pb2 import Event
from tramstream.proto.sync_pb2 import Snapshot
from tramstream.recorder.file.writer import RecordFile
from tramstream.recorder.reader import open_record
from tramstream.recorder.reprocess import parallel
from tramstream.recorder.reprocess.order import Output
from tramstream.recorder.reprocess.plan import Plan

VEHICLE = "contract"
CUTS = 3
"""Random places at which a ride is interrupted."""
FOLLOWING = 1000
"""Outputs after an interruption that must be the same."""
_Said = tuple[str, int, int, bytes]


class ProcessorContract(ABC):
    """Tests of the last of `make`'s processors; those before it make its inputs."""

    @abstractmethod
    def make(self) -> list[Processor]:
        """Fresh processors; the one that is tested is the last."""

    @abstractmethod
    def samples(self) -> Iterable[Sample]:
        """A ride, in the order of its stamps: the same at each call."""

    def others(self) -> list[Processor]:
        """Fresh processors that run beside it."""
        return []

    # The tests -----------------------------------------------------------------------------------
    def test_makes_only_what_it_declares_and_numbers_it(self) -> None:
        tested = self.make()[-1]
        declared = {key.path for key in tested.outputs}
        numbers: dict[str, int] = {}
        for _, _, outputs in self._steps(self.make()):
            for path, _, sequence, _ in outputs:
                assert path in declared, f"{path} is not among the outputs of {tested.name}"
                assert sequence == numbers.get(path, 0) + 1, f"{path}: {sequence} is out of turn"
                numbers[path] = sequence
        assert numbers, f"{tested.name} said nothing on this ride; give it another"

    def test_raises_only_events_that_it_declares(self) -> None:
        tested = self.make()[-1]
        declared = {kind.name: dict(kind.facts) for kind in tested.events}
        path = keys.EVENT.at(tested.name).path
        for _, _, outputs in self._steps(self.make()):
            for data in (payload for place, _, _, payload in outputs if place == path):
                event = decode(Event, data, path)
                assert event.kind in declared, f"{event.kind} is no event that {path} declares"
                types = {name: type(value) for name, value in facts_of(event).items()}
                assert types == declared[event.kind], f"{event.kind}: other facts than declared"

    def test_changes_no_sample_that_it_gets(self) -> None:
        for sample, before, _ in self._steps(self.make()):
            assert sample.message.SerializeToString() == before

    def test_says_the_same_again_alone_and_with_others(self) -> None:
        alone = self._all(self.make())
        assert self._all(self.make()) == alone
        assert self._all([*self.make(), *self.others()]) == alone

    def test_goes_on_from_its_memory_wherever_it_was_cut(self) -> None:
        ride = [sample for sample, _, _ in self._steps(self.make())]
        tested = self.make()[-1]
        whole = [_said(tested.step(sample)) for sample in ride]
        for cut in random.Random(1).sample(range(len(ride)), min(CUTS, len(ride))):
            first, second = self.make()[-1], self.make()[-1]
            for sample in ride[:cut]:
                first.step(sample)
            memory = Snapshot(states=snapshots.take([first]))
            assert snapshots.restore(memory, [second]), f"{second.name} refuses its own memory"
            compared = 0
            for sample, expected in zip(ride[cut:], whole[cut:], strict=True):
                assert _said(second.step(sample)) == expected, f"cut before sample {cut}"
                assert _said(first.step(sample)) == expected, "a snapshot has changed the processor"
                compared += len(expected)
                if compared >= FOLLOWING:
                    break

    def test_reprocesses_to_the_same_bytes_on_one_core_and_on_two(self, tmp_path: Path) -> None:
        path = tmp_path / "ride.mcap"
        with RecordFile(path, VEHICLE) as file:
            for sample in self.samples():
                topic, data = sample.key.on(VEHICLE), sample.message.SerializeToString()
                time_ns = sample.publish_ns or sample.stamp_ns
                file.append(topic, sample.key, data, time_ns, time_ns, sample.sequence)
        one, two = (self._reprocessed(path, cores) for cores in (1, 2))
        tested = {key.path for key in self.make()[-1].outputs}
        assert {path for path, *_ in one} & tested, "nothing came of the record"
        assert one == two

    # How -----------------------------------------------------------------------------------------
    def _steps(self, made: list[Processor]) -> Iterable[tuple[Sample, bytes, list[_Said]]]:
        """What the tested processor gets, the same encoded, and what it makes of it."""
        front, tested = Graph(made[:-1]), made[-1]
        wanted = {key.path for key in tested.inputs}
        for sample in self.samples():
            for each in (sample, *front.step(sample)):
                if each.key.path in wanted:
                    before = each.message.SerializeToString()
                    yield each, before, _said(tested.step(each))

    def _all(self, processors: list[Processor]) -> list[_Said]:
        graph, made = Graph(processors), {key.path for key in self.make()[-1].outputs}
        return [
            said
            for sample in self.samples()
            for said in _said(graph.step(sample))
            if said[0] in made
        ]

    def _reprocessed(self, path: Path, cores: int) -> list[_Said]:
        found: list[_Said] = []

        def take(session: int, log_ns: int, outputs: list[Output]) -> None:
            found.extend((s.key.path, s.stamp_ns, s.sequence, data) for s, data in outputs)

        with open_record(path) as record:
            processors = [*self.make(), *self.others()]
            parallel.run(record, processors, Plan(), parallel.Takers(take), cores)
        return found


def _said(outputs: list[Sample]) -> list[_Said]:
    return [
        (each.key.path, each.stamp_ns, each.sequence, each.message.SerializeToString())
        for each in outputs
    ]
