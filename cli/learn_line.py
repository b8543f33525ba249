"""`tramstream learn-line RECORDS... -o FILE`: a line's signature from rides along it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def learn_line(
    records: Annotated[
        list[Path],
        typer.Argument(metavar="RECORDS...", help="Rides from the first stop to the last."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="File to write.")],
    line: Annotated[str, typer.Option(help="What the line is called.")] = "line",
    direction: Annotated[str, typer.Option(help="And its direction.")] = "0",
    config: Annotated[
        Path | None, typer.Option(help="Configuration instead of those in the records.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace FILE.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
) -> None:
    """Learn a line from rides along all of it: its curves and stops, with their spread, for the
    processor `segments` (`$.segments.signatures`). Wheels or IMU alone, no map, no GNSS."""
    import json
    import math

    from tramstream.analysis.segments import learning
    from tramstream.cli.segments import frames_of
    from tramstream.cli.terminal.page_file import make_place
    from tramstream.config_file import load
    from tramstream.recorder.reader import open_record
    from tramstream.recorder.reprocess.run import vehicle_of
    from tramstream.shown import shown, shown_json
    from tramstream.tracks import signature_file

    make_place(out, records, overwrite)
    traces = []
    for path in records:
        with open_record(path) as opened:
            vehicle = load(config) if config is not None else vehicle_of(opened, path)
            traces.append(learning.trace_of(vehicle, frames_of(opened, path)))
    made = learning.learn(traces, line, direction)
    signature_file.save(made, out)
    curves = [each for each in made.pieces() if each.curve]
    figures = {
        "line": made.line,
        "direction": made.direction,
        "rides": made.rides,
        "length_m": made.length_m,
        "stops": len(made.stops_m),
        "curves": len(curves),
        "yaw_std_deg": math.degrees(made.yaw_std_rad),
        "stop_std_m": made.stop_std_m,
    }
    if as_json:
        print(shown_json(json.dumps(figures, ensure_ascii=False)))
        return
    for name, value in figures.items():
        print(shown(f"{name:12}{value:.4g}" if isinstance(value, float) else f"{name:12}{value}"))
