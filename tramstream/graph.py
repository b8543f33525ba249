"""Processors as a graph: the one place where a sample is stepped through everybody who wants it.

Who declares a key as an input gets every sample on it, whoever made it. A sample is stepped through
all its readers, in the order of the processors, before what follows from it is: so the order is the
same live, in reprocessing, on one core and on several, and in a notebook. Processors may feed each
other in a ring, as filter and map matcher do, where somebody in it lets what came back wait:

    graph = Graph([Resampler(vehicle), LocalisationFilter(vehicle)])
    for sample in ride.samples():
        for made in graph.step(sample):
            ...
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from tramstream.errors import ConfigError
from tramstream.keys import Key
from tramstream.processor import Processor, Sample

_Step = Callable[[Sample], list[Sample]]


class Graph:
    """Processors that feed each other.

    Parameters
    ----------
    processors : sequence of Processor
        Two of them may not make the same key.
    failed : callable or None
        Gets what a processor raises, and the others go on; with None it is raised to the caller.
    step_of : callable or None
        Gives what steps a processor instead of its own `step`.

    Raises
    ------
    ConfigError
        If two processors make the same key: their numbers on it would say nothing.
    """

    def __init__(
        self,
        processors: Sequence[Processor],
        failed: Callable[[Exception], None] | None = None,
        step_of: Callable[[Processor], _Step] | None = None,
    ) -> None:
        self.processors = list(processors)
        self._steps: dict[str, list[_Step]] = {}
        self.outputs: dict[str, Key] = {}
        """What is made inside, by path."""
        read: dict[str, Key] = {}
        for processor in self.processors:
            step = processor.step if step_of is None else step_of(processor)
            if failed is not None:
                step = _guarded(step, failed)
            for key in processor.inputs:
                read.setdefault(key.path, key)
                self._steps.setdefault(key.path, []).append(step)
            for key in processor.outputs:
                if key.path in self.outputs:
                    raise ConfigError(
                        f"two processors make {key.path}", cure="switch one of them off"
                    )
                self.outputs[key.path] = key
        self.inputs = {path: key for path, key in read.items() if path not in self.outputs}
        """What must come from outside, by path."""

    def reads(self, path: str) -> bool:
        """Whether a processor wants samples on `path`."""
        return path in self._steps

    def readers(self, path: str) -> list[Processor]:
        """The processors that want samples on `path`, in order."""
        return [each for each in self.processors if any(key.path == path for key in each.inputs)]

    def step(self, sample: Sample) -> list[Sample]:
        """Step a sample through its readers, and what follows likewise; all that was made."""
        return self.follow((sample,))

    def follow(self, samples: Iterable[Sample]) -> list[Sample]:
        """Step samples that followed from one and the same; all that follows, in order."""
        steps = self._steps
        made: list[Sample] = []
        for sample in samples:
            for step in steps.get(sample.key.path, ()):
                made += step(sample)
        for sample in made:  # grows meanwhile: what follows is stepped in its turn
            for step in steps.get(sample.key.path, ()):
                made += step(sample)
        return made


def _guarded(step: _Step, failed: Callable[[Exception], None]) -> _Step:
    """`step` whose exceptions are told: a bug in one stage keeps no other from its samples."""

    def guarded(sample: Sample) -> list[Sample]:
        try:
            return step(sample)
        except Exception as error:  # noqa: BLE001  the boundary of the stages: told, never hidden
            failed(error)
            return []

    return guarded
