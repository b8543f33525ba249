"""A ride that is stopped while its recorder hears nothing is whole, or says what is missing."""

from __future__ import annotations

import os
import signal
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from live import HANG_S, short_folder, until
from test_pipeline import Running

from tramstream import keys
from tramstream.cli.terminal.demo_vehicle import configuration
from tramstream.clock import VehicleClock
from tramstream.proto.health_pb2 import Loss
from tramstream.recorder.reader import open_record
from tramstream.transport.bus import Envelope, ZenohBus

pytestmark = pytest.mark.live

UNRECORDED = ("health/recorder/", "health/router/", "health/clock/")
"""Of the recorder that was killed, and of the router, which outlives every recorder."""


@pytest.fixture
def folder() -> Iterator[Path]:
    with short_folder() as path:
        yield path


class Witness:
    """Hears what is published, beside the recorder."""

    def __init__(self, runtime_dir: Path) -> None:
        self.heard: Counter[str] = Counter()
        self._bus = ZenohBus.connect(runtime_dir, VehicleClock.shared(runtime_dir))
        self._bus.subscribe(keys.full("demo", "**"), self._take)

    def _take(self, envelope: Envelope) -> None:
        path = keys.split(envelope.topic)[1]
        if not path.startswith(UNRECORDED):
            self.heard[envelope.topic] = max(self.heard[envelope.topic], envelope.sequence)

    def close(self) -> None:
        self._bus.close()


def here_or_named(folder: Path) -> tuple[dict[str, int], int]:
    """By topic, how many messages the record has or names lost; and how many it names."""
    found: Counter[str] = Counter()
    named = 0
    with open_record(folder / "records") as record:
        for entry in record.messages():
            found[entry.topic] += 1
            if keys.split(entry.topic)[1] == keys.LOSS.at("recorder").path:
                loss = record.decode(entry)
                assert isinstance(loss, Loss)
                found[loss.key] += loss.count
                named += loss.count
    return found, named


@pytest.mark.parametrize("number", [signal.SIGSTOP, signal.SIGKILL])
def test_ride_stopped_right_after_its_recorder_is_whole_or_says_what_is_missing(
    folder: Path, number: signal.Signals
) -> None:
    config = folder / "ride.toml"
    config.write_text(configuration(folder, seed=3))
    run = Running(config, folder)
    try:
        run.nodes()
        run.grow(200_000)
        witness = Witness(folder / "run")
        until(lambda: len(witness.heard) > 10, "the witness to hear")
        before = sum(witness.heard.values())
        os.kill(run.node("recorder"), number)
        until(lambda: sum(witness.heard.values()) > before + 500, "traffic without a recorder")
        run.process.send_signal(signal.SIGTERM)
        status = run.process.wait(HANG_S)
        witness.close()
    finally:
        run.clean_up()
    found, named = here_or_named(folder)
    missing = {
        topic: (last, found[topic]) for topic, last in witness.heard.items() if found[topic] < last
    }
    assert missing == {}, run.log()
    assert status == (3 if named else 0), run.log()
