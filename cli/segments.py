"""`tramstream segments RECORD`: dwells, passages, comfort and energy of a ride, without GNSS."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from tramstream.analysis.segments.timetable import Told
    from tramstream.processor import Sample
    from tramstream.recorder.reader import Record


def segments(
    record: Annotated[
        Path, typer.Argument(metavar="RECORD", help="Record, or the folder with its parts.")
    ],
    config: Annotated[
        Path | None, typer.Option(help="Configuration instead of that in the record.")
    ] = None,
    net: Annotated[
        Path | None, typer.Option(help="Network whose lines are looked for.", metavar="FILE")
    ] = None,
    line: Annotated[
        list[Path] | None,
        typer.Option(help="Line of `learn-line` to look for; may be repeated.", metavar="FILE"),
    ] = None,
    parquet: Annotated[
        Path | None, typer.Option(help="Write the sections to FILE.parquet.", metavar="FILE")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace that file.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
) -> None:
    """Tell a ride by its stops and sections: dwells, passages at the line's stops, speeds, jerk,
    lateral acceleration, work of the motors. It goes by wheels and IMU alone."""
    import json

    from tramstream.analysis.segments import timetable
    from tramstream.cli.terminal.page_file import make_place
    from tramstream.config_file import load
    from tramstream.errors import DamagedRecordError
    from tramstream.recorder.reader import open_record
    from tramstream.recorder.reprocess.run import vehicle_of
    from tramstream.shown import shown_json
    from tramstream.tracks import network, signature, signature_file

    if parquet is not None:
        make_place(parquet, [record], overwrite, "--parquet")
    lines = [signature_file.load(each) for each in line or ()]
    if net is not None:
        lines += signature.of_network(network.load(net))
    with open_record(record) as opened:
        vehicle = load(config) if config is not None else vehicle_of(opened, record)
        told = timetable.read(vehicle, frames_of(opened, record), lines)
        damaged = opened.damaged or opened.left_out
    if parquet is not None:
        _write(told, parquet)
    if as_json:
        print(shown_json(json.dumps(_plain(told), ensure_ascii=False)))
    else:
        _print(told)
    if damaged:
        raise DamagedRecordError(damaged)


def frames_of(record: Record, path: Path) -> Iterator[Sample]:
    """Frames of the ordered stream.

    Raises
    ------
    RecordError
        If the record has none.
    """
    from tramstream import keys
    from tramstream.errors import RecordError
    from tramstream.processor import Sample

    count = 0
    path_of = keys.SYNC_FRAME.path
    for entry, message in record.decoded(lambda topic: keys.split(topic)[1] == path_of):
        count += 1
        yield Sample(keys.SYNC_FRAME, message, message.stamp_ns, message.sequence, entry.publish_ns)
    if not count:
        raise RecordError(
            f"{path}: has no {path_of}; make it with `tramstream reprocess {path} -o OUT`"
        )


def _write(told: Told, path: Path) -> None:
    from tramstream.analysis.segments.timetable import Section
    from tramstream.recorder.exports.arrays import write_columns

    columns = {name: [getattr(each, name) for each in told.sections] for name in Section._fields}
    write_columns(columns, path)


def _plain(told: Told) -> dict[str, Any]:
    return {
        "sections": [_row(each) for each in told.sections],
        "passages": [_row(each) for each in told.passages],
        "turns": [
            {
                "start_m": each.start_m,
                "end_m": each.end_m,
                "angle_deg": math.degrees(each.angle_rad),
                "radius_m": each.radius_m,
                "radius_std_m": each.radius_std_m,
            }
            for each in told.events
            if each.HasField("angle_rad")
        ],
        "said": sorted(set(told.said)),
    }


def _row(each: Any) -> dict[str, Any]:
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in each._asdict().items()
    }


def _print(told: Told) -> None:
    from datetime import UTC, datetime

    from rich.console import Console
    from rich.table import Table

    from tramstream.shown import shown

    console = Console(width=max(Console().width, 150))
    table = Table(box=None, header_style="bold")
    heads: Sequence[str] = ("from", "to", "depart", "travel s", "dwell s", "way m", "mean m/s")
    for head in (*heads, "top m/s", "a m/s²", "brake m/s²", "jerk m/s³", "lateral m/s²", "kWh"):
        table.add_column(head, justify="left" if head in ("from", "to") else "right", no_wrap=True)
    for each in told.sections:
        depart = datetime.fromtimestamp(each.depart_ns / 1e9, UTC).strftime("%H:%M:%S")
        figures = (each.travel_s, each.dwell_s, each.way_m, each.mean_mps, each.top_mps)
        more = (each.most_acceleration_mps2, each.most_braking_mps2, each.most_jerk_mps3)
        table.add_row(
            shown(each.begin),
            shown(each.end),
            depart,
            *(f"{value:.1f}" for value in figures),
            *(f"{value:.2f}" for value in (*more, each.most_lateral_mps2, each.traction_kwh)),
        )
    console.print(table)
    for passage in told.passages:
        at = datetime.fromtimestamp(passage.passed_ns / 1e9, UTC).strftime("%H:%M:%S")
        stood = f", stood {passage.stood_s:.0f} s" if passage.stood_s else ""
        console.print(
            f"{at}  line {shown(passage.line)}  {shown(passage.stop)}{stood}", markup=False
        )
    for kind in sorted(set(told.said)):
        console.print(kind, markup=False)
