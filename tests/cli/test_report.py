"""The page of a report: one file, evaluate's own figures, whatever a record has or lacks."""

from __future__ import annotations

import base64
import gzip
import json
import math
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from looking import tramstream
from report_samples import OUTAGE_S, START_NS, VEHICLE, MadeUpRide, whole_ride, write

from tramstream import keys
from tramstream.analysis.report.charts import POINTS, Timeline, Trace, broken
from tramstream.analysis.report.compose import compose
from tramstream.analysis.report.health import mode_runs, rates_figure
from tramstream.analysis.report.material import Runs, inside, long_runs
from tramstream.analysis.report.page import Page, figure
from tramstream.analysis.report.source import collect
from tramstream.cli.report import report
from tramstream.clock import S
from tramstream.errors import DamagedRecordError, TramstreamError

RIDE_S = 60.0


class Reader(HTMLParser):
    """Text, tables and links of a page; scripts and styles apart."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.tags: list[str] = []
        self.text: list[str] = []
        self.scripts: list[str] = []
        self.rows: list[list[str]] = []
        self._open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self._open.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "action")]
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        while self._open and self._open.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if "script" in self._open:
            self.scripts.append(data)
        elif "style" not in self._open:
            self.text.append(data)
            if self.rows and self._open[-1:] and self._open[-1] in ("td", "th"):
                self.rows[-1][-1] += data


def read(page: str) -> Reader:
    reader = Reader()
    reader.feed(page)
    reader.close()
    return reader


def series(page: str) -> list[np.ndarray]:
    """All numbers that the page's figures are drawn from."""
    found = []
    for text in re.findall(r'"data":"([A-Za-z0-9+/=]+)"', page):
        data = base64.b64decode(text)
        found.append(gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data)
    return [np.frombuffer(each, "<f4") for each in found if len(each) % 4 == 0]


@pytest.fixture(scope="module")
def ride(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return whole_ride(tmp_path_factory.mktemp("report") / "ride.mcap", RIDE_S)


@pytest.fixture(scope="module")
def page(ride: Path) -> str:
    return compose(collect(ride, "", "", print))


# One file -----------------------------------------------------------------------------------------
def test_page_asks_no_network(page):
    reader = read(page)
    assert [link for link in reader.links if not link.startswith("#")] == []
    assert not {"link", "img", "iframe", "object", "embed"} & set(reader.tags)
    assert "default-src 'none'" in page
    style = page[page.index("<style>") : page.index("</style>")]
    assert "url(" not in style
    assert "@import" not in style


def test_links_of_the_page_lead_to_its_sections(page):
    named = set(re.findall(r'<h2 id="([^"]+)"', page))
    assert {link.removeprefix("#") for link in read(page).links} == named


def test_text_of_the_record_is_text_of_the_page(page):
    assert "<b>no fix</b>" not in page.replace("\\u003cb", "<b")
    assert "<b>no fix</b> & no hope" in "".join(read(page).text)


def test_title_is_vehicle_and_utc_of_the_host(page):
    """The record's clock reference says that UTC is 7 s ahead of the vehicle clock."""
    title = re.search("<title>(.*)</title>", page)
    assert title
    assert title[1] == f"Vehicle {VEHICLE}, 2026-09-21 14:13 UTC"
    assert "14:13:27 to 14:14:26 UTC" in "".join(read(page).text)


# Figures and series -------------------------------------------------------------------------------
def test_figures_are_those_of_evaluate(ride, page):
    judged = json.loads(tramstream("evaluate", ride, "--json").stdout)
    row = next(row for row in read(page).rows if row[0] == "filter")
    names = [f"horizontal_{kind}_m" for kind in ("p50", "p90", "p95", "max")]
    names += ["along_rms_m", "across_rms_m", "speed_std_mps", "yaw_rms_deg"]
    assert row[1:9] == [figure(judged[name]) for name in names]
    assert row[9] == figure(judged["nees_joint_mean"] / judged["nees_joint_dimensions"])
    assert row[10] == judged["verdict"]
    sides = [row for row in read(page).rows if row[:1] == ["filter"] and len(row) == 4]
    assert [row[2] for row in sides[:2]] == [
        figure(judged[f"protection_{side}_mean_m"]) for side in ("along", "across")
    ]


def test_slope_of_the_track_is_judged_and_drawn_apart_from_the_pitch(ride, page):
    judged = json.loads(tramstream("evaluate", ride, "--json").stdout)
    rows = read(page).rows
    row = next(row for row in rows if row[:1] == ["grade of the track, %"])
    names = ("grade_rms_pct", "grade_p95_pct", "grade_max_pct", "nees_grade_mean")
    assert row[1:5] == [figure(judged[name]) for name in names]
    for what in ("roll, °", "pitch of the body, °", "grade of the track, %"):
        assert any(what in row[:2] for row in rows), what


def test_truths_grade_is_the_tracks_and_not_the_bodys_pitch(tmp_path):
    made = MadeUpRide(20.0)
    samples = list(made.truth())
    for sample in samples:
        sample.message.grade_rad, sample.message.pitch_rad = 0.03, 0.05
    drawn = series(compose(collect(write(tmp_path / "t.mcap", iter(samples)), "", "", print)))
    constant = {round(float(each[0]), 4) for each in drawn if len(each) > 5 and np.ptp(each) == 0}
    assert round(100 * math.tan(0.03), 4) in constant
    assert round(math.degrees(0.05), 4) in constant
    assert round(100 * math.tan(-0.05), 4) not in constant


def test_page_without_a_slope_says_that_pitch_is_the_bodys(tmp_path):
    made = MadeUpRide(10.0)
    path = write(tmp_path / "a.mcap", made.truth(), made.estimate(keys.EST_STATE))
    text = "".join(read(compose(collect(path, "", "", print))).text)
    assert "pitch is the body's, and no slope of the track" in text


def test_every_section_is_filled(page):
    assert "absent" not in re.findall(r'<p class="(\w+)"', page)


def test_series_reach_the_page_with_their_extremes(ride, page):
    material = collect(ride, "", "", print)
    drawn = series(page)
    for column in (material.states.speed_mps, material.fixes.speed_mps):
        top = np.float32(column.max())
        assert any((each == top).any() for each in drawn if len(each))


def test_long_series_is_thinned(tmp_path):
    timeline = Timeline(START_NS, START_NS + 100 * S)
    stamp_ns = START_NS + np.arange(50_000) * (S // 500)
    value = np.zeros(50_000)
    value[31_415] = 1.0
    plot = timeline.figure("", "m", [Trace("spike", stamp_ns, value, "black")])
    (source,) = {each.data_source for each in plot.renderers}
    assert len(source.data["value"]) <= POINTS
    assert source.data["value"].max() == 1.0


def test_line_is_broken_by_silence():
    stamp_ns = START_NS + np.array([0, 1, 2, 20, 21]) * S
    stamps, table = broken(stamp_ns, np.arange(5.0)[:, None])
    assert np.isnan(table[:, 0]).tolist() == [False, False, False, True, False, False]
    assert (np.diff(stamps) > 0).all()


# What happened ------------------------------------------------------------------------------------
def test_outage_and_standstill_are_found(ride):
    material = collect(ride, "", "", print)
    (start,), (end,) = ((each - START_NS) / S for each in material.outages)
    assert (start, end) == (
        pytest.approx(OUTAGE_S[0], abs=0.2),
        pytest.approx(OUTAGE_S[1], abs=0.2),
    )
    assert len(material.standing.start_ns) >= 1


def test_runs_are_cut_at_both_ends():
    stamp_ns = START_NS + np.arange(10) * S
    mask = np.array([1, 1, 1, 0, 1, 0, 0, 1, 1, 1], dtype=bool)
    runs = long_runs(mask, stamp_ns, S)
    assert ((runs.start_ns - START_NS) // S).tolist() == [0, 7]
    assert ((runs.end_ns - START_NS) // S).tolist() == [2, 9]
    assert inside(stamp_ns, runs).tolist() == [True] * 3 + [False] * 4 + [True] * 3
    nothing = Runs(stamp_ns[:0], stamp_ns[:0])
    assert not inside(stamp_ns, nothing).any()


def test_rate_that_falls_is_seen():
    timeline = Timeline(START_NS, START_NS + 100 * S)
    edges_ns = START_NS + np.arange(0, 101, 10) * S
    rate = np.full(10, 5.0)
    rate[3], rate[4] = 2.0, 0.0
    plot = rates_figure(timeline, edges_ns, {keys.GNSS_FIX.path: rate})
    named = {item.label.value: item.renderers[0] for item in plot.legend[0].items}
    assert set(named) == {"steady", "slower", "none"}
    assert list(named["slower"].data_source.data["rate"]) == [2.0]
    assert len(named["steady"].data_source.data["rate"]) == 2


def test_modes_of_the_filter_are_runs_without_gaps(ride):
    runs = mode_runs(collect(ride, "", "", print).states)
    assert [run.state for run in runs] == ["TRACKING", "DEAD_RECKONING", "TRACKING"]
    assert [run.end_ns for run in runs[:-1]] == [run.start_ns for run in runs[1:]]


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (0.01234, "0.012"), (1.234, "1.23"), (12.34, "12.3"), (1234.5, "1\u202f234")],
)
def test_numbers_are_written_for_people(value, text):
    assert figure(value) == text


# What is lacking ----------------------------------------------------------------------------------
def made(path: Path, *names: str) -> Path:
    ride = MadeUpRide(30.0)
    return write(path, *(getattr(ride, name)() for name in names))


@pytest.mark.parametrize(
    "names", [("fixes",), ("wheels",), ("truth",), ("health",), ("parameters",)]
)
def test_record_of_one_kind_gives_a_page_that_says_what_is_lacking(tmp_path, names):
    page = compose(collect(made(tmp_path / "one.mcap", *names), "", "", print))
    text = "".join(read(page).text)
    assert "No est/ekf/state in the record" in text
    assert ("No raw/gnss/fix in the record." in text) == ("fixes" not in names)
    assert ("No truth" in text) == ("truth" not in names)


def test_states_without_truth_give_their_stated_deviation(tmp_path):
    ride = MadeUpRide(30.0)
    path = write(tmp_path / "states.mcap", ride.estimate(keys.EST_STATE))
    rows = read(compose(collect(path, "", "", print))).rows
    assert ["filter", "speed, m/s", "0.050", "0.050", "0.050", "0.050"] in rows


def test_states_without_covariance_or_level_are_drawn(tmp_path):
    ride = MadeUpRide(10.0)
    samples = list(ride.estimate(keys.EST_STATE))
    for sample in samples:
        for name in ("covariance", "innovations", "protection_along_m", "protection_across_m"):
            sample.message.ClearField(name)
    path = write(tmp_path / "bare.mcap", iter(samples), ride.truth())
    text = "".join(read(compose(collect(path, "", "", print))).text)
    assert "No innovations in the record" in text


def test_single_message_gives_a_page(tmp_path):
    path = write(tmp_path / "one.mcap", iter([next(MadeUpRide(1.0).fixes())]))
    assert "Summary" in compose(collect(path, "", "", print))


def test_outputs_find_inputs_and_truth_in_their_source(tmp_path):
    ride = MadeUpRide(30.0)
    write(tmp_path / "source.mcap", ride.truth(), ride.fixes(), ride.health())
    states = ride.estimate(keys.EST_STATE)
    metadata = {"reprocessed_from": "source.mcap"}
    path = write(tmp_path / "out.mcap", states, metadata=metadata)
    material = collect(path, "", "", print)
    assert material.states is not None
    assert material.ride.truth is not None
    assert material.ride.fixes is not None
    assert material.health.nodes
    assert {keys.EST_STATE.path, keys.GNSS_FIX.path} <= set(material.rates_hz)
    (tmp_path / "source.mcap").unlink()
    assert collect(path, "", "", print).ride.truth is None


def test_truth_of_another_record_is_used(tmp_path):
    ride = MadeUpRide(30.0)
    other = write(tmp_path / "truth.mcap", ride.truth())
    path = write(tmp_path / "states.mcap", ride.estimate(keys.EST_STATE))
    assert collect(path, str(other), "", print).ride.truth is not None


def test_smoothed_states_may_stand_for_the_filter(ride):
    material = collect(ride, "", keys.EST_SMOOTHED.path, print)
    assert material.states is material.smoothed


# The verb -----------------------------------------------------------------------------------------
def test_verb_writes_the_page_and_says_where(ride, tmp_path):
    out = tmp_path / "page.html"
    done = tramstream("report", ride, "-o", out, "--json")
    figures = json.loads(done.stdout)
    assert done.returncode == 0
    assert figures["size_bytes"] == out.stat().st_size
    assert figures["duration_s"] == pytest.approx(RIDE_S, abs=0.2)
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"file": "nonsense.mcap"}, "nonsense.mcap"),
        ({"file": "none.mcap"}, "none.mcap"),
        ({"file": "empty.mcap"}, "holds no message"),
        ({"out": "ride.mcap", "overwrite": True}, "is what would be read"),
        ({"out": "there.html"}, "--overwrite"),
        ({"out": "nowhere/page.html"}, "folder does not exist"),
        ({"truth": "no/such/key"}, "no such file and no key"),
        ({"estimate": "est/none/state"}, "est/none/state"),
    ],
)
def test_bad_input_is_one_sentence_with_the_cure(ride, tmp_path, change, words):
    shutil.copy(ride, tmp_path / "ride.mcap")
    (tmp_path / "nonsense.mcap").write_bytes(b"no record at all")
    (tmp_path / "there.html").write_text("kept")
    write(tmp_path / "empty.mcap")
    options = {"file": "ride.mcap", "out": "page.html", "truth": "", "estimate": ""} | change
    options |= {name: tmp_path / options[name] for name in ("file", "out")}
    with pytest.raises(TramstreamError, match=re.escape(words)) as caught:
        report(**{"overwrite": False, "json_": False, **options})
    assert caught.value.exit_status == 2
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "page.html").exists()
    assert (tmp_path / "there.html").read_text() == "kept"


def test_page_is_replaced_when_asked_to(tmp_path, capsys):
    out = tmp_path / "page.html"
    out.write_text("old")
    path = write(tmp_path / "one.mcap", iter([next(MadeUpRide(1.0).fixes())]))
    report(path, out, truth="", estimate="", overwrite=True, json_=False)
    assert out.read_text().startswith("<!doctype html>")
    assert capsys.readouterr().out == f"{out}\n"


def test_damaged_record_gives_its_page_and_status_3(ride, tmp_path):
    damaged, out = tmp_path / "damaged.mcap", tmp_path / "page.html"
    shutil.copy(ride, damaged)
    data = bytearray(damaged.read_bytes())
    data[len(data) // 3] ^= 0xFF
    damaged.write_bytes(data)
    with pytest.raises(DamagedRecordError, match="damaged") as caught:
        report(damaged, out, truth="", estimate="", overwrite=False, json_=False)
    assert caught.value.exit_status == 3
    assert "damaged" in out.read_text()


def test_page_without_figures_needs_no_script():
    from bokeh.document import Document

    page = Page("Nothing", ["at all"])
    page.section("Empty")
    assert "<script" not in page.render(Document())
