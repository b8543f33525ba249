"""The map matcher with real processes: killed on the way, and beside somebody else's filter."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from live import HANG_S, command, short_folder, tramstream, until
from networks import network_of
from rides import laid, reference, ridden

from tramstream import keys
from tramstream.cli.terminal.demo_vehicle import configuration
from tramstream.clock import VehicleClock
from tramstream.config import MATCHER
from tramstream.estimation.localiser import TRACKING
from tramstream.graph import Graph
from tramstream.lines.line import built_in_line
from tramstream.processor import Sample
from tramstream.processors.localisation.processor import LocalisationFilter
from tramstream.processors.warm_up import one_track
from tramstream.proto.estimate_pb2 import MapMatch, MotionState
from tramstream.recorder.file.writer import RecordFile
from tramstream.supervision import roster
from tramstream.transport.bus import Envelope, ZenohBus

pytestmark = pytest.mark.live

THEIRS = keys.define("est/theirs/state", MotionState, 100.0, "state", "Another localiser")
PLAN = "| 120 L60/70 100 R80/60 80 |"


@pytest.fixture
def folder() -> Iterator[Path]:
    with short_folder() as made:
        yield made


@contextmanager
def process(*arguments: object, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A verb that runs until it is told to end."""
    with log.open("w") as stream:
        child = subprocess.Popen(command(*arguments), stderr=stream)
        try:
            yield child
        finally:
            if child.poll() is None:
                child.send_signal(signal.SIGINT)
            child.wait(HANG_S)


def heard(bus: ZenohBus, topic: str) -> list[Envelope]:
    """Everything on a topic from now on; it grows."""
    found: list[Envelope] = []
    bus.subscribe(topic, found.append)
    return found


def node(folder: Path, name: str) -> int:
    """Process of a node of the run in `folder`; 0 if it is not there."""
    known = roster.read(folder / "run")
    found = known.living().get(name) if known is not None else None
    return found.pid if found is not None else 0


def test_killed_matcher_goes_on_and_the_ride_is_repeated(folder: Path, tmp_path: Path) -> None:
    network = folder / "line.tracks"
    one_track(built_in_line()).save(network)
    config = folder / "ride.toml"
    text = configuration(folder, seed=4).replace(
        "\n\n", f'\nseparate = ["{MATCHER}"]\n\n[map]\nnetwork = "{network}"\n\n', 1
    )
    config.write_text(text)
    with process("run", config, log=folder / "log.txt") as run:
        until(lambda: node(folder, MATCHER) or run.poll() is not None, "the matcher")
        first = node(folder, MATCHER)
        with closing(ZenohBus.connect(folder / "run", VehicleClock.shared(folder / "run"))) as bus:
            tracks = heard(bus, keys.MAP_TRACK.on("demo"))
            states = heard(bus, keys.EST_STATE.on("demo"))
            until(lambda: len(tracks) > 20 or run.poll() is not None, "the track")
            os.kill(first, signal.SIGKILL)
            until(lambda: node(folder, MATCHER) not in (0, first), "another matcher")
            before, begun = len(tracks), len(states)
            until(lambda: len(tracks) > before + 20, "the track again")
            assert len(states) > begun, "the filter goes on"
        run.send_signal(signal.SIGINT)
        assert run.wait(HANG_S) == 0, (folder / "log.txt").read_text()
    again = tramstream(
        *("reprocess", folder / "records", "-o", tmp_path / "r.mcap", "--check", "--json")
    )
    figures = json.loads(again)
    assert figures["identical"], figures


def recorded(path: Path) -> int:
    """Write what another localiser said, and nothing else; give how many states have a heading."""
    ride = ridden(laid(PLAN), reference(), 1, 40.0)
    graph = Graph([LocalisationFilter(ride.simulation.vehicle)])
    count = 0
    with RecordFile(path, "theirs") as file:
        for number, frame in enumerate(ride.frames):
            for made in graph.step(Sample(keys.SYNC_FRAME, frame, frame.stamp_ns, number)):
                if made.key is keys.EST_STATE:
                    count += made.message.mode == TRACKING
                    data = made.message.SerializeToString()
                    times = made.stamp_ns, made.stamp_ns, made.sequence
                    file.append(THEIRS.on("theirs"), THEIRS, data, *times)
    return count


def test_matcher_follows_the_filter_of_a_replayed_record(folder: Path) -> None:
    """No filter, no bridge, no supervisor: `node map_matcher` and `replay`."""
    count = recorded(folder / "theirs.mcap")
    network_of([laid(PLAN)]).save(folder / "line.tracks")
    config = folder / "theirs.toml"
    config.write_text(
        f'vehicle = "theirs"\n[bus]\nruntime_dir = "{folder}/run"\n'
        f'[map]\nnetwork = "{folder}/line.tracks"\nsource = "{THEIRS.path}"\n'
    )
    env = {**os.environ, "TRAMSTREAM_RUNTIME_DIR": str(folder / "run")}
    with process("node", "router", config, log=folder / "router.txt"):
        until((folder / "run" / "bus.sock").exists, "the bus")
        with (
            process("node", MATCHER, config, log=folder / "matcher.txt") as matcher,
            closing(ZenohBus.connect(folder / "run", VehicleClock.shared(folder / "run"))) as bus,
        ):
            matches = heard(bus, keys.MAP_MATCH.on("theirs"))
            tracks = heard(bus, keys.MAP_TRACK.on("theirs"))
            alive = keys.alive("theirs", MATCHER)
            until(lambda: bus.alive(alive) or matcher.poll() is not None, "the matcher")
            tramstream(
                *("replay", folder / "theirs.mcap", "--as", "theirs", "--onto-live"),
                *("--rate", "0", "--keys", THEIRS.path),
                env=env,
            )
            until(lambda: len(matches) >= count, "all matches", lambda: len(matches))
    said = [MapMatch.FromString(each.payload) for each in matches]
    later = [each for each in said if each.direction_known][-500:]
    assert {(each.state, each.run) for each in later} == {(MapMatch.ON_TRACK, 0)}
    assert len(tracks) > 20
