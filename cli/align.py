"""`tramstream align RECORD…`: how the IMU is turned in its vehicle, out of ordinary rides."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from tramstream.analysis.mounting.align import Answer, Ride
    from tramstream.calibrated import Source
    from tramstream.config import Vehicle


def align(
    records: Annotated[
        list[Path], typer.Argument(help="Records of one vehicle, or folders with the parts of one.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", help="Calibration to write: OUT.toml, for `calibration` of a vehicle."
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(help="Configuration of the vehicle, instead of the record's.", metavar="TOML"),
    ] = None,
    model: Annotated[
        str, typer.Option(help="ours, or melenovsky2023 to compare.", metavar="MODEL")
    ] = "ours",
    cross_level_deg: Annotated[
        float,
        typer.Option(
            "--cross-level-deg", help="How far straight track is from level across.", min=0.0
        ),
    ] = 0.3,
    cross_level_m: Annotated[
        float, typer.Option("--cross-level-m", help="Over which way that is one error.", min=1.0)
    ] = 50.0,
    page: Annotated[Path | None, typer.Option(help="Page to write, PAGE.html.")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace OUT and PAGE.")] = False,
    json_: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Find the mounting of the IMU, any turn, without measuring anything in the vehicle.

    Wants fixes and a ride: halts, curves, some straight track. Several rides are put together.
    First it says whether the sensors are sound, whether the vehicle moved enough and for which
    angle; without that there is no figure and status 1. Deviations are about the vehicle's axes.
    """
    import json
    import time

    from rich.console import Console

    from tramstream.analysis.mounting.known import Settings
    from tramstream.analysis.mounting.records import align as align_records
    from tramstream.calibrated import Source
    from tramstream.cli.terminal.page_file import make_place, write
    from tramstream.cli.terminal.session import say
    from tramstream.config_file import load
    from tramstream.errors import CheckFailedError, ConfigError, DamagedRecordError
    from tramstream.recorder.reader import open_record

    if model not in ("ours", "melenovsky2023"):
        raise ConfigError(f"--model {model}: there are ours and melenovsky2023")
    for each in (out, page):
        if each is not None:
            make_place(each, records, overwrite)
    vehicle = load(config) if config is not None else None
    if model == "melenovsky2023":
        if out is not None or page is not None:
            raise ConfigError("--out, --page: of ours alone; leave out --model")
        _work(records, vehicle, json_)
        return
    began_s = time.perf_counter()
    opened = [(path, open_record(path)) for path in records]
    try:
        settings = Settings(cross_level_deg, cross_level_m)
        with Console(stderr=True).status("reading") as status:
            found = align_records(opened, settings, vehicle, status.update)
        damaged = next((each.damaged for _, each in opened if each.damaged), "")
        left_out = next((each.left_out for _, each in opened if each.left_out), "")
        sources = tuple(
            Source.of(str(path), each.vehicle, each.start_ns, each.end_ns) for path, each in opened
        )
    finally:
        for _, record in opened:
            record.close()
    if out is not None and not found.verdict:
        write(out, fragment(found, sources))
    if page is not None:
        from tramstream.analysis.report.align_page import compose

        write(page, compose(found, angle_rows(found)))
    if json_:
        print(json.dumps(plain(found) | {"elapsed_s": time.perf_counter() - began_s}))
    else:
        _print(found)
    for text in (damaged, left_out):
        if text:
            say(text)
    if found.verdict:
        raise CheckFailedError(f"{', '.join(map(str, records))}: {found.verdict}")
    if damaged or left_out:
        raise DamagedRecordError(damaged or left_out)


def _work(records: list[Path], vehicle: Vehicle | None, json_: bool) -> None:
    """Print what the work's two stages say of each ride."""
    import json

    import numpy as np

    from tramstream.analysis.melenovsky2023.records import estimates
    from tramstream.errors import CheckFailedError
    from tramstream.recorder.reader import open_record

    opened = [(path, open_record(path)) for path in records]
    try:
        found = list(estimates(opened, vehicle))
    finally:
        for _, record in opened:
            record.close()
    told = []
    for each in found:
        begun = np.degrees([each.initial.roll_rad, each.initial.pitch_rad, each.initial.yaw_rad])
        last, std = np.degrees(each.psi_rad), np.degrees(each.std_rad)
        rows = {"initial_deg": begun, "mounting_deg": last, "euler_std_deg": std}
        fine = {
            name: row.round(4).tolist() if np.all(np.isfinite(row)) else None
            for name, row in rows.items()
        }
        told.append({"name": each.name, "trouble": each.trouble, **fine})
    if json_:
        print(json.dumps({"model": "melenovsky2023", "rides": told}))
    else:
        for one in told:
            print(
                f"{one['name']}: {one['trouble']}"
                if one["trouble"]
                else f"{one['name']}: initial {one['initial_deg']}, filter {one['mounting_deg']} "
                f"± {one['euler_std_deg']} (roll, pitch, yaw, °)"
            )
    if not found or any(each.trouble for each in found):
        troubles = "; ".join(dict.fromkeys(each.trouble for each in found if each.trouble))
        raise CheckFailedError(f"melenovsky2023: {troubles or 'there is no ride'}")


def quaternion(found: Answer) -> list[float]:
    """q_bv, w first and not negative."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(found.C_bv).as_quat().tolist()
    sign = -1.0 if w < 0 else 1.0
    return [round(sign * each, 9) for each in (w, x, y, z)]


def angle_rows(found: Answer) -> list[tuple[str, ...]]:
    """Lines of a table of the angles; none without an answer."""
    import numpy as np

    from tramstream.mounting import angles_of

    if found.verdict:
        return []
    w, x, y, z = quaternion(found)
    angles = angles_of((w, x, y, z))
    std, upright = np.degrees(found.std_rad), np.degrees(found.upright_rad)
    names = ("roll", "pitch", "yaw")
    return [
        (names[k], f"{angles[k]:.3f}", "xyz"[k], f"{std[k]:.3f}", f"{upright[k]:.3f}")
        for k in range(3)
    ]


def fragment(found: Answer, sources: tuple[Source, ...]) -> str:
    """The text of the calibration."""
    import numpy as np

    from tramstream.calibrated import Provenance
    from tramstream.calibration_file import document

    std = [round(each, 5) for each in np.degrees(found.std_rad).tolist()]
    imu = {"mounting_q_bv": quaternion(found), "mounting_std_deg": std}
    provenance = Provenance.now("align", sources, {}, tuple(found.notes))
    return document({"imu": imu}, provenance)


def plain(found: Answer) -> dict[str, Any]:
    """All figures, without NaN, which JSON does not have."""
    import numpy as np

    from tramstream.mounting import angles_of

    told = not found.verdict
    q = quaternion(found) if told else None
    return {
        "verdict": found.verdict,
        "mounting_q_bv": q,
        "mounting_deg": list(angles_of((q[0], q[1], q[2], q[3]))) if q else None,
        "mounting_std_deg": np.degrees(found.std_rad).tolist() if told else None,
        "cross_level_part_deg": np.degrees(found.upright_rad).tolist() if told else None,
        "chance": found.chance,
        "notes": found.notes,
        "rides": [_ride(each, told) for each in found.rides],
    }


def _ride(ride: Ride, told: bool) -> dict[str, Any]:
    import numpy as np

    solution = ride.solution if told and not ride.trouble else None
    noise = solution.noise if solution is not None else None
    return {
        "name": ride.name,
        "trouble": ride.trouble,
        "moved_at_s": ride.moved.at_s if ride.moved else None,
        "motion": ride.motion._asdict(),
        "theses": [
            {"text": each.text, "value": each.value if each.asked else None, "holds": each.holds}
            for each in ride.theses
        ],
        "C_bv": solution.C_vb.T.tolist() if solution is not None else None,
        "std_deg": (
            np.degrees(np.sqrt(np.diag(solution.covariance))).tolist() if solution else None
        ),
        "passes": solution.passes if solution is not None else None,
        "side_mps": noise.side_mps if noise is not None else None,
        "up_mps": noise.up_mps if noise is not None else None,
    }


def _print(found: Answer) -> None:
    import sys

    from rich.console import Console
    from rich.table import Table

    from tramstream.shown import shown

    console = Console(width=None if sys.stdout.isatty() else 120)

    def line(text: str) -> None:
        console.print(shown(text), markup=False, highlight=False, soft_wrap=True)

    for ride in found.rides:
        m = ride.motion
        line(
            f"{ride.name}: {m.duration_s:.0f} s, {m.way_m:.0f} m ({m.straight_m:.0f} m straight), "
            f"{m.halts} departures, braking {m.braked_mps2:.2f} m/s² and curves "
            f"{m.curved_mps2:.2f} m/s² RMS, {m.fixes} fixes, "
            f"{'wheels' if m.wheels else 'no wheels'}"
            + (f", {m.reverse_s:.0f} s in reverse" if m.reverse_s else "")
        )
    if found.verdict:
        return
    for ride in found.rides:
        for each in ride.theses:
            mark = "holds" if each.holds else "FAILS"
            value = f"{each.value:.3g}{each.unit}" if each.asked else "the ride does not tell"
            line(f"  {mark if each.asked else '-':<6} {each.text}: {value}")
    table = Table(box=None, pad_edge=False, collapse_padding=True, header_style="bold")
    for name in ("", "mounting °", "about", "σ °", "of it cross-level °"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in angle_rows(found):
        table.add_row(*row)
    console.print(table)
    line(f"[imu] mounting_q_bv = {quaternion(found)}")
    for note in found.notes:
        line(note)
