"""`tramstream import`: captured device bytes, and tables of numbers, into a record."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def import_(
    out: Annotated[Path, typer.Option("--out", "-o", help="Record to write.")],
    ubx: Annotated[
        Path | None, typer.Option(help="Receiver capture: UBX, NMEA and RTCM mixed.")
    ] = None,
    nmea: Annotated[Path | None, typer.Option(help="NMEA log (the same decoder).")] = None,
    adis: Annotated[
        Path | None, typer.Option(help="IMU capture in the framing of docs/imu-framing.md.")
    ] = None,
    can: Annotated[
        Path | None, typer.Option(help="CAN log as `candump -L` writes it, or `candump -t a`.")
    ] = None,
    dbc: Annotated[Path | None, typer.Option(help="DBC that names the CAN log's signals.")] = None,
    wheel: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=MESSAGE.SIGNAL[:UNIT]",
            help="A wheel, repeated; default: all wheel speeds of the DBC. UNIT (km/h, m/s, "
            "pulses …) where the DBC has none.",
        ),
    ] = None,
    bus: Annotated[
        str, typer.Option(help="Interface of the CAN log to decode, e.g. can0, if several.")
    ] = "",
    csv: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FILE|FOLDER|NAME=FILE",
            help="Table, or folder of the tables, that --mapping tells of; repeated. NAME is what "
            "the mapping calls the file. Default: beside the mapping.",
        ),
    ] = None,
    mapping: Annotated[
        Path | None,
        typer.Option(help="What the tables' columns are: units, frames, clock (TOML)."),
    ] = None,
    cut: Annotated[
        list[str] | None,
        typer.Option(
            metavar="START_S:DURATION_S",
            help="Withhold the tables' fixes for so long, so much after the first row; repeated.",
        ),
    ] = None,
    offset_s: Annotated[
        list[str] | None,
        typer.Option(
            "--offset-s",
            metavar="SOURCE=SECONDS",
            help="Add so much to the times of gnss, imu or can, whose clocks differ; repeated.",
        ),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="Vehicle configuration for delays, scales and signals.")
    ] = None,
    vehicle: Annotated[str, typer.Option(help="Vehicle identifier of the record.")] = "",
    model: Annotated[str, typer.Option(help="IMU model of --adis.")] = "ADIS16465-1",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace OUT.")] = False,
    json_: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Import captures and tables; several sources of one ride go into one record.

    Captures of receivers and IMUs hold no arrival times: each read is given the time that its
    frames tell. The record's clock is GPS time as Unix time, as a receiver's; the UTC of a CAN log
    is put onto it. An IMU counts from when it was switched on: --offset-s says when that was.

    Tables are put on the same clock. How to write a --mapping: docs/import-tables.md, mappings/.
    """
    import json

    from tramstream.analysis.tables import clocks
    from tramstream.analysis.tables.captures import Imports
    from tramstream.analysis.tables.tables import Tables, parse_cut
    from tramstream.cli.terminal.session import make_room, say
    from tramstream.errors import ConfigError

    if ubx is not None and nmea is not None:
        raise ConfigError("--ubx and --nmea are one receiver each; import them one by one")
    if can is not None and dbc is None and config is None:
        raise ConfigError("--can needs --dbc (or --config with an [odometer] section)")
    if mapping is None and (csv or cut):
        raise ConfigError(
            "--csv and --cut need --mapping; mappings/ and docs/import-tables.md help"
        )
    sources = [source for source in (ubx, nmea, adis, can) if source is not None]
    tables = None
    if mapping is not None:
        tables = Tables(mapping, csv or [], [parse_cut(text) for text in cut or []])
        sources += [mapping, *tables.files.values()]
    if not sources:
        raise ConfigError("nothing to import; give --ubx, --nmea, --adis, --can or --mapping")
    make_room(out, sources, overwrite)
    offsets = dict(clocks.parse_offset(text) for text in offset_s or [])
    given = {"gnss": ubx or nmea, "imu": adis, "can": can}
    for name in offsets:
        if given[name] is None:
            raise ConfigError(f"--offset-s {name}: nothing of it is imported; leave it out")
    imports = Imports(config, vehicle, model, offsets)
    if tables is not None:
        imports.tables(tables)
    receiver = ubx or nmea
    if receiver is not None:
        imports.gnss(receiver)
    if adis is not None:
        imports.imu(adis)
    if can is not None:
        chosen = imports.can(can, dbc, wheel or [], bus)
        say(f"{can}: wheels {chosen}")
    result: dict[str, Any] = imports.write(out)
    if nothing := _nothing_in(result, {"gnss": receiver, "imu": adis, "odometer": can}):
        out.unlink()
        raise ConfigError(*nothing)
    if json_:
        print(json.dumps(result))
        return
    _tell(out, result, can)


_CURES = {
    "gnss": "is it a capture of UBX, NMEA or RTCM, at the receiver's baud rate? --adis and --can "
    "take other devices'",
    "imu": "is it in the framing of docs/imu-framing.md, and --model the right one?",
    "odometer": "does the DBC describe this bus (`candump -L` writes the log), and --wheel name "
    "signals that are on it?",
}


def _nothing_in(result: dict[str, Any], files: dict[str, Path | None]) -> tuple[str, str] | None:
    """The sentence and the cure for a capture in which nothing decodes."""
    for device, counters in result["devices"].items():
        if counters["messages_decoded"]:
            continue
        rejected = f"{counters['frames_rejected']} frames rejected"
        reasons = ", ".join(f"{n} {why}" for why, n in counters["rejected_by_reason"].items())
        lines = result["malformed_lines"] if device == "odometer" else 0
        told = [f"{rejected} ({reasons})" if reasons else rejected]
        told += [f"{lines} lines are no CAN frames"] if lines else []
        return f"{files[device]}: nothing in it decodes: {', '.join(told)}", _CURES[device]
    return None


def _tell(out: Path, result: dict[str, Any], can: Path | None) -> None:
    """What became of an import, for people."""
    from tramstream.cli.terminal.session import say

    for key, count in result["messages"].items():
        say(f"{key:28} {count:8d}")
    for device, counters in result["devices"].items():
        reasons = ", ".join(f"{n} {reason}" for reason, n in counters["rejected_by_reason"].items())
        say(
            f"{device}: {counters['messages_decoded']} decoded, {counters['frames_rejected']} "
            f"rejected ({counters['bytes_rejected']} bytes){': ' + reasons if reasons else ''}"
        )
    of_tables = 0
    for table in result["tables"]:
        say(_told(table))
        of_tables += table["malformed_lines"]
    if result["malformed_lines"] > of_tables:
        lines = result["malformed_lines"] - of_tables
        first = result["can"]["first_malformed"]
        say(f"{can}: {lines} lines are no CAN frames and were left out; {first}")
    for text in _told_of_log(result["can"]):
        say(f"{can}: {text}")
    print(f"{out}: {sum(result['messages'].values())} messages")


def _told(table: dict[str, Any]) -> str:
    """What became of a table, for people."""
    text = (
        f"{table['file']}: {table['rows']} rows of {table['kind']}, {table['duration_s']:.1f} s "
        f"from {table['start_s']:.3f} s on"
    )
    if "given" in table:
        text += f", {table['withheld']} of them withheld"
    if "rate_hz" in table:
        text += f", {table['rate_hz']:.3f} Hz, stamps moved by {1e3 * table['jitter_s']:.2f} ms"
    if table["malformed_lines"]:
        text += f"; {table['malformed_lines']} left out: {table['first_malformed']}"
    return text


def _told_of_log(log: dict[str, Any]) -> list[str]:
    """What was odd about a CAN log, for people."""
    told = []
    if log.get("odd"):
        told.append(f"{log['odd']} frames have stamps that do not fit, and were left out")
    if log.get("unheard"):
        told.append(f"no frame of {', '.join(log['unheard'])}")
    if log.get("set_back"):
        told.append(
            f"its clock was set back {log['set_back']} times, by {log['set_back_s']:.3f} s in all; "
            "later frames were moved on"
        )
    return told
