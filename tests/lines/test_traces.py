"""Traces from GPX and GeoJSON, and what is done with odd ones."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest

from tramstream.clock import S
from tramstream.errors import ConfigError
from tramstream.lines.traces import HDOP_M, parse, read

START = datetime(2026, 9, 21, 14, 13, 27, 250_000, tzinfo=UTC)
START_NS = round(START.timestamp() * 1e3) * 1_000_000
PLACES = [(50.08, 14.42), (50.081, 14.421), (50.082, 14.423)]
"""Latitude, longitude, deg."""
GPX = '<gpx xmlns="http://www.topografix.com/GPX/1/1" version="1.1">{}</gpx>'


def time_after(seconds: float) -> str:
    stamp = datetime.fromtimestamp(START.timestamp() + seconds, UTC)
    return stamp.isoformat().replace("+00:00", "Z")


def points(tag: str, *insides: str) -> str:
    rows = zip(PLACES, insides, strict=True)
    return "".join(
        f'<{tag} lat="{lat}" lon="{lon}">{inside}</{tag}>' for (lat, lon), inside in rows
    )


def track(*insides: str) -> bytes:
    return GPX.format(f"<trk><trkseg>{points('trkpt', *insides)}</trkseg></trk>").encode()


def timed(*seconds: float) -> list[str]:
    return [f"<time>{time_after(each)}</time>" for each in seconds]


def line(**properties: Any) -> bytes:
    coordinates = [[longitude, latitude, 230.0] for latitude, longitude in PLACES]
    geometry = {"type": "LineString", "coordinates": coordinates}
    return json.dumps({"type": "Feature", "geometry": geometry, "properties": properties}).encode()


def test_gpx_gives_places_and_times_to_the_microsecond():
    trace = parse(track(*timed(0, 1, 2.5)), "ride.gpx")
    assert (trace.stamp_ns - START_NS).tolist() == [0, S, 2_500_000_000]
    degrees = np.degrees(np.stack([trace.latitude_rad, trace.longitude_rad], axis=1))
    np.testing.assert_allclose(degrees, PLACES, atol=1e-12)
    assert trace.timed
    assert trace.notes == ()
    assert np.isnan(trace.accuracy_m).all()


def test_accuracy_is_that_of_the_extension_else_of_hdop():
    inside = timed(0, 1, 2)
    inside[0] += "<hdop>1.2</hdop><extensions><gpxx:accuracy>4.5</gpxx:accuracy></extensions>"
    inside[1] += "<hdop>2</hdop>"
    inside[2] += "<hdop>0</hdop>"
    text = track(*inside).replace(b"<gpx ", b'<gpx xmlns:gpxx="x" ')
    trace = parse(text, "ride.gpx")
    assert trace.accuracy_m[:2].tolist() == [4.5, 2 * HDOP_M]
    assert math.isnan(trace.accuracy_m[2])


def test_route_is_read_where_there_is_no_track():
    route = f"<rte>{points('rtept', '', '', '')}</rte>"
    trace = parse(GPX.format(route).encode(), "plan.gpx")
    assert len(trace.stamp_ns) == 3
    assert not trace.timed
    assert np.diff(trace.stamp_ns).tolist() == [S, S]
    assert "1 s apart" in trace.notes[0]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "utf-8-sig"])
def test_gpx_of_any_encoding_is_told_from_json(encoding):
    text = track(*timed(0, 1, 2)).decode()
    if encoding == "utf-16":
        text = f"<?xml version='1.0' encoding='utf-16'?>{text}"
    assert len(parse(text.encode(encoding), "ride").stamp_ns) == 3


def test_points_without_time_or_out_of_order_are_left_out_and_counted():
    rows = [(0, 50.0), (1, 50.1), (1, 50.2), (None, 50.3), (2, 95.0), (3, 50.4)]
    inside = "".join(
        f'<trkpt lat="{lat}" lon="14">{"" if at is None else timed(at)[0]}</trkpt>'
        for at, lat in rows
    )
    trace = parse(GPX.format(inside).encode(), "ride.gpx")
    assert np.degrees(trace.latitude_rad).round(6).tolist() == [50.0, 50.1, 50.4]
    assert len(trace.notes) == 3
    assert all("1 points" in note for note in trace.notes)


@pytest.mark.parametrize(
    "properties",
    [
        {"coordTimes": [time_after(k) for k in range(3)]},
        {"coordinateProperties": {"times": [time_after(k) for k in range(3)]}},
        {"coordTimes": [START.timestamp() + k for k in range(3)]},
        {"coordTimes": [1000 * START.timestamp() + 1000 * k for k in range(3)]},
    ],
)
def test_geojson_line_has_the_times_of_its_coordinates(properties):
    trace = parse(line(accuracy=3, **properties), "ride.geojson")
    np.testing.assert_allclose(trace.stamp_ns - START_NS, np.arange(3) * S, atol=1000)
    assert trace.accuracy_m.tolist() == [3.0] * 3
    assert np.degrees(trace.latitude_rad[2]) == pytest.approx(PLACES[2][0])


def test_geojson_points_are_a_trace():
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [longitude, latitude]},
            "properties": {"time": time_after(index), "hdop": 1},
        }
        for index, (latitude, longitude) in enumerate(PLACES)
    ]
    text = json.dumps({"type": "FeatureCollection", "features": features}).encode()
    trace = parse(text, "points.geojson")
    assert (np.diff(trace.stamp_ns) == S).all()
    assert trace.accuracy_m.tolist() == [HDOP_M] * 3


def test_line_without_times_is_read_as_one_second_apart():
    trace = parse(line(), "drawn.geojson")
    assert not trace.timed
    assert np.diff(trace.stamp_ns).tolist() == [S, S]


BOMB = b'<!DOCTYPE g [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]><gpx><trkpt>&b;</trkpt></gpx>'


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (BOMB, "document type"),
        (BOMB.decode().encode("utf-16"), "document type"),
        (b"<gpx><trk>", "is no XML"),
        (b"<kml></kml>", "no GPX"),
        (b"<gpx></gpx>", "no track and no route points"),
        (b"{", "neither GPX nor GeoJSON"),
        (b"[]", "neither LineStrings nor Points"),
        (b'{"type": "FeatureCollection", "features": [{"geometry": 3}]}', "neither LineStrings"),
        (line().replace(b"[14.42,", b'["x",'), ""),
        (b'{"type": "LineString", "coordinates": [[14, 50]]}', "has 1 usable points"),
        (b'{"type": "LineString", "coordinates": 7}', "has no usable points"),
        (track(*["<time>noon</time>"] * 3), ""),
        (track(*timed(2, 1, 0)), "no times one after the other"),
    ],
)
def test_bad_trace_is_refused_with_one_sentence(text, told):
    if not told:
        assert parse(text, "odd").notes
        return
    with pytest.raises(ConfigError, match=told) as refused:
        parse(text, "odd")
    assert str(refused.value).startswith("odd: ")


@pytest.mark.parametrize("time", ["9999-01-01T00:00:00Z", 1e300, -1e18, "2026-13-01", [], {}])
def test_time_that_none_can_be_is_none(time):
    trace = parse(line(coordTimes=[time, time_after(1), time_after(2)]), "ride.geojson")
    assert (trace.stamp_ns - START_NS).tolist() == [S, 2 * S]


def test_trace_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        read(tmp_path / "no.gpx")


@pytest.mark.parametrize("time", [1e308, -1e308, 1e30, "9" * 5000])
def test_time_that_no_clock_shows_is_none(time: object) -> None:
    line = {"type": "LineString", "coordinates": [[14.4, 50.0], [14.41, 50.0], [14.42, 50.0]]}
    document = {"type": "Feature", "properties": {"times": [time, 1, 2]}, "geometry": line}
    trace = parse(json.dumps(document).encode(), "a.geojson")
    assert np.all(trace.stamp_ns >= 0)
