"""The live page in a real Chromium: what it shows, asks for and complains of."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

import pytest
from browser import Tab, browser, needs_browser
from looking import VEHICLE
from networks import town

from tramstream import keys
from tramstream.clock import VehicleClock
from tramstream.proto.estimate_pb2 import GradeState, MapMatch, MotionState
from tramstream.proto.gnss_pb2 import GnssFix, GnssSatellites
from tramstream.proto.health_pb2 import DeviceHealth, Event, NodeHealth
from tramstream.tracks.network import LineStop, RouteLine
from tramstream.transport.bus import LocalBus
from tramstream.web.access import Access, Address
from tramstream.web.app import encoded
from tramstream.web.rails import drawing
from tramstream.web.serve import Page, serving

pytestmark = needs_browser
EVIL = '<img src=x onerror="window.broken=1"><script>window.broken=1</script>'
SPEED_MPS = 10.0


class Riding:
    """A bus on which a vehicle goes along the first track of a town, twenty times a second."""

    def __init__(self) -> None:
        from dataclasses import replace

        self.network = replace(
            town(),
            lines=(
                RouteLine("7", "0", "West", EVIL, (0, 2), 0.0, 900.0,
                          (LineStop(EVIL, 150.0), LineStop("Square", 300.0))),
            ),
        )  # fmt: skip
        self.bus = LocalBus(VehicleClock())
        self._stop = threading.Event()
        self._number = 0
        self._thread = threading.Thread(target=self._ride)
        self._thread.start()

    def _ride(self) -> None:
        while not self._stop.wait(0.05):
            self._number += 1
            self._publish(self._number)

    def _publish(self, number: int) -> None:
        now_ns = self.bus.clock.now_ns()
        along_m = 100.0 + SPEED_MPS * number * 0.05 % 400.0
        sample = self.network.starts[0] + int(along_m / self.network.spacing_m[0])
        plan = [[self.network.east[sample], self.network.north[sample]]]
        latitude_deg, longitude_deg = (
            math.degrees(each) for each in self.network.geodetic_of(plan)[0]
        )
        place = {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg}
        state = MotionState(
            stamp_ns=now_ns, sequence=number, mode=MotionState.TRACKING, **place,
            speed_mps=SPEED_MPS, protection_along_m=3.0, protection_across_m=1.0, along_std_m=0.5,
        )  # fmt: skip
        state.innovations.add(measurement="gnss_east", value=1, variance=1, accepted=number % 9 > 0)
        match = MapMatch(
            stamp_ns=now_ns, state=MapMatch.ON_TRACK, run=0, edge=EVIL, probability=0.9,
            chainage_m=along_m,
        )  # fmt: skip
        match.references.add(line="7", direction="0", chainage_m=along_m)
        said: list[tuple[keys.Key, object]] = [
            (keys.EST_STATE, state), (keys.EST_NOW, state), (keys.MAP_MATCH, match),
            (keys.EST_GRADE, GradeState(stamp_ns=now_ns, grade_rad=0.01, grade_std_rad=0.001)),
            (keys.GNSS_FIX, GnssFix(stamp_ns=now_ns, valid=True, satellites_used=9, **place)),
        ]  # fmt: skip
        if number % 20 == 1:
            sky = GnssSatellites(stamp_ns=now_ns)
            sky.satellites.add(gnss_id=0, sv_id=3, cno_dbhz=44, elevation_deg=40, azimuth_deg=120,
                               used=True)  # fmt: skip
            said += [
                (keys.GNSS_SATELLITES, sky),
                (keys.HEARTBEAT.at("gnss"),
                 NodeHealth(node="gnss", text=EVIL, state=NodeHealth.DEGRADED)),
                (keys.DEVICE.at("gnss"), DeviceHealth(device=EVIL, port="p")),
                (keys.EVENT.at("tram"),
                 Event(stamp_ns=now_ns, source="tram", kind="tram.x", sentence=EVIL)),
            ]  # fmt: skip
        for key, message in said:
            payload = message.SerializeToString()
            self.bus.publish(key.on(VEHICLE), payload, key.encoding, number)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.bus.close()


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    riding = Riding()
    page = Page(riding.bus, VEHICLE, encoded(drawing(riding.network)))
    try:
        with serving(page, Address("127.0.0.1", 0), Access()) as shown:
            yield shown
    finally:
        riding.close()


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    with browser(tmp_path_factory.mktemp("profile")) as found:
        yield found


def riding_in(tab: Tab, address: str, *screen: int, dark: bool = False) -> None:
    """Open the page and wait until the vehicle moves on it."""
    tab.problems.clear()
    tab.requests.clear()
    tab.open(address, *screen, dark=dark)
    tab.until("window.tramstream && window.tramstream.latencies.length > 5")
    tab.until("document.querySelectorAll('#devices tbody tr').length > 0")
    tab.until("document.querySelectorAll('#events li').length > 0")


@pytest.mark.parametrize("width", [1280, 1600, 390])
@pytest.mark.parametrize("dark", [False, True])
def test_page_shows_the_vehicle_on_every_screen_without_complaint(
    tab: Tab, address: str, width: int, dark: bool, tmp_path: Path
) -> None:
    riding_in(tab, address, width, 900, dark=dark)
    tab.until("Number(document.getElementById('speed-value').textContent) === 36")
    tab.until("!document.getElementById('line').hidden")
    assert tab.evaluate("document.querySelector('.vehicle-icon') !== null")
    assert tab.evaluate("document.documentElement.scrollWidth") <= width, "it scrolls sideways"
    background = tab.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (background == "rgb(255, 255, 255)") is not dark
    tab.picture(tmp_path / "page.png")
    assert (tmp_path / "page.png").stat().st_size > 10_000
    assert tab.problems == []
    outside = [each for each in tab.requests if address.split("/")[2] not in each]
    assert outside == []


def test_words_of_the_vehicle_stay_words(tab: Tab, address: str) -> None:
    riding_in(tab, address)
    tab.until("document.body.innerText.includes('<script>')")
    assert tab.evaluate("window.broken === undefined")
    assert tab.evaluate("document.querySelectorAll('img[src=x]').length") == 0


def test_page_is_usable_with_a_screen_reader_and_the_keyboard(tab: Tab, address: str) -> None:
    for dark in (False, True):
        riding_in(tab, address, 1280, 900, dark=dark)
        tab.evaluate(files("axe_core_python").joinpath("axe.min.js").read_text() + "; null")
        found = tab.evaluate("axe.run(document).then((found) => found.violations)")
        serious = [
            (each["id"], [node["html"] for node in each["nodes"]])
            for each in found
            if each["impact"] in ("serious", "critical")
        ]
        assert serious == []
    for key, expression in (
        ("h", "window.tramstream.map.headingUp"),
        ("f", "!window.tramstream.map.following"),
        ("3", "document.querySelector('button.window[value=\"3600\"]').ariaPressed === 'true'"),
        ("t", "document.documentElement.dataset.theme === 'light'"),
    ):
        tab.does("Input.dispatchKeyEvent", type="keyDown", key=key, text=key)
        assert tab.evaluate(expression), key


@pytest.mark.parametrize(("language", "words"), [("de", "Ereignisse"), ("cs", "Události")])
def test_page_speaks_other_languages(tab: Tab, address: str, language: str, words: str) -> None:
    riding_in(tab, address)
    tab.evaluate(
        f"document.getElementById('language').value = '{language}';"
        "document.getElementById('language').dispatchEvent(new Event('change')); null"
    )
    assert tab.evaluate("document.getElementById('events-title').textContent") == words
    assert tab.evaluate("document.documentElement.lang") == language
    tab.evaluate("localStorage.clear(); null")


def test_every_word_of_the_page_is_there_in_every_language(tab: Tab, address: str) -> None:
    riding_in(tab, address)
    found = tab.evaluate(
        "import('./texts.js').then((t) => "
        "[...document.querySelectorAll('[data-text],[data-label]')]"
        ".map((e) => e.dataset.text || e.dataset.label).filter((key) => !t.known(key)))"
    )
    assert found == []


def test_hours_of_data_do_not_make_the_page_grow(tab: Tab, address: str) -> None:
    """Eight hours of frames, as fast as the page takes them: an hour is kept, the rest goes."""
    riding_in(tab, address)
    sizes = []
    for part in range(4):
        tab.evaluate(
            f"""(() => {{
              const {{ map, strips, frames }} = window.tramstream;
              const frame = structuredClone(frames());
              for (let k = 0; k < 72000; k += 1) {{
                const t = 3e9 + {part} * 7200 + k / 10;
                frame.row[0] = t;
                frame.state.latitude_deg += 1e-5;
                strips.add(frame);
                map.add(frame);
                if (k % 7200 === 0) {{ map.draw(frame); strips.draw(true); }}
              }}
            }})()"""
        )
        tab.does("HeapProfiler.collectGarbage")
        sizes.append(tab.does("Runtime.getHeapUsage")["usedSize"])
    assert sizes[-1] < 1.1 * sizes[0] + 1e6, sizes
    assert tab.problems == []
