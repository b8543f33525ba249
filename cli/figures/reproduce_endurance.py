"""`tramstream reproduce endurance`: a captured minute through a vehicle for a day; what grew?"""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tramstream.analysis.endurance import study
from tramstream.analysis.endurance.study import Found
from tramstream.analysis.endurance.vehicle import BUS, DBC, MINUTE_S, RECEIVER, Case
from tramstream.cli.figures.options import Options
from tramstream.cli.terminal.session import say, stop_on_signals
from tramstream.clock import S
from tramstream.errors import ConfigError, DamagedRecordError
from tramstream.machine import compilation

NAME = "endurance"
DATA = Path("../shared/data")
SAY_PARTS = 12
"""An hour of the vehicle's time, in files of its record."""
WIDTH = 120
MB = 1e6
GROWN = 1.05
"""Memory that is larger at the end by more than this part is said to have grown."""


def reproduce(options: Options) -> None:
    """Play, watch, reckon; an hour of the vehicle is said as soon as it is over."""
    case = _case(options)
    stop = stop_on_signals()
    compilation.ensure(say, stop=stop)
    folder = Path(tempfile.mkdtemp(prefix="tramstream-endurance-", dir="/tmp"))
    found = study.study(case, folder, stop.is_set, _tell)
    shutil.rmtree(folder, ignore_errors=True)  # kept where the vehicle failed
    if options.json:
        print(json.dumps(_plain(case, found)))
    else:
        _print(Console(width=max(Console().width, WIDTH)), case, found)
    books = found.books
    if stop.is_set():
        say("ended by hand: what was on the lines then was not received")
    if books.wrong or books.missing or not (books.exact or stop.is_set()):
        raise DamagedRecordError(
            f"the books do not add up: {_inexact(found)}", cure="this is a bug; please report it"
        )


def _case(options: Options) -> Case:
    data = options.data or DATA
    case = Case(options.capture or data / RECEIVER, data / BUS, data / DBC)
    for path in (case.receiver, case.bus, case.dbc):
        if not path.is_file():
            raise ConfigError(f"{path}: is not there; give the folder of the captures with --data")
    given: dict[str, Any] = {}
    if options.hours is not None:
        given["hours"] = options.hours
    if options.pace is not None:
        given["pace"] = options.pace
    return Case(case.receiver, case.bus, case.dbc, **given)


def _tell(found: Found) -> None:
    if found.parts % SAY_PARTS:
        return
    books = found.books
    now = found.samples[-1] if found.samples else None
    memory = 0.0 if now is None else sum(now.pss_mb.values())
    say(
        f"{(books.end_ns - books.begin_ns) / S / 3600:.1f} h in {found.elapsed_s:.0f} s: "
        f"{books.messages} messages, {memory:.0f} MB, {books.ledgers} ledgers, "
        f"{books.wrong} wrong, {books.lost} lost or not used"
    )


def _inexact(found: Found) -> str:
    books = found.books
    texts = [f"{books.wrong} ledgers"] if books.wrong else []
    texts += [
        f"{line.device}: {line.sent} {line.unit} sent, {line.received} received"
        for line in books.lines()
        if not line.exact
    ]
    texts += [f"{topic}: {off} missing" for topic, off in list(books.missing.items())[:5]]
    return "; ".join([*texts, *books.examples[:3]]) or "a node has no ledger"


def _plain(case: Case, found: Found) -> dict[str, Any]:
    books = found.books
    return {
        "work": NAME,
        "hours": (books.end_ns - books.begin_ns) / S / 3600,
        "pace": case.pace,
        "elapsed_s": found.elapsed_s,
        "played_s": _played_s(case, found),
        "status": found.status,
        "exact": books.exact,
        "messages": books.messages,
        "heartbeats": books.heartbeats,
        "ledgers": books.ledgers,
        "ledgers_wrong": books.wrong,
        "missing": books.missing,
        "early": dict(books.early),
        "lines": [line._asdict() | {"exact": line.exact} for line in books.lines()],
        "lost": {f"{consumer} {cause}": n for (consumer, cause), n in books.losses.items()},
        "events": {f"{source} {kind}": n for (source, kind), n in books.events.items()},
        "restarts": dict(books.restarts),
        "stages": [
            {"node": node} | {name: getattr(stage, name) for name in _STAGE}
            for node, beat in sorted(books.last.items())
            for stage in beat.stages
        ],
        "memory_mb": found.memory(),
        "parts": found.parts,
        "record_bytes": found.record_bytes,
        "most_disk_bytes": found.most_disk_bytes,
        "samples": [sample._asdict() for sample in found.samples],
    }


_STAGE = ("stage", "unit", "received", "delivered", "dropped", "pending")


# Tables -------------------------------------------------------------------------------------------
def _print(console: Console, case: Case, found: Found) -> None:
    books = found.books
    hours = (books.end_ns - books.begin_ns) / S / 3600
    minutes = max(60 * hours, 1e-9)
    console.print(
        f"{NAME}: {hours:.2f} h of the vehicle in {found.elapsed_s:.0f} s, {case.pace:g} times as "
        f"fast; a minute of {case.receiver.name} and {case.bus.name} and an IMU that stands were "
        f"played {_played_s(case, found) / MINUTE_S:.0f} times",
        soft_wrap=True,
    )
    table = Table(box=None, pad_edge=False, collapse_padding=True)
    for column in ("process", "MB at 1/8", "MB at the end", "times"):
        table.add_column(column, justify="left" if column == "process" else "right")
    for name, (early, late) in found.memory().items():
        grown = " grown" if late > GROWN * early else ""
        table.add_row(name, f"{early:.1f}", f"{late:.1f}", f"{late / early:.3f}{grown}")
    console.print("", table, "")
    _print_stages(console, found)
    console.print(
        f"{books.messages} messages on {books.topics} keys, {books.messages / minutes:.0f} a minute"
        f" of the vehicle; {found.parts} files, {found.record_bytes / MB:.0f} MB, at most "
        f"{found.most_disk_bytes / MB:.0f} MB at once",
        soft_wrap=True,
    )
    for line in books.lines():
        word = "exact" if line.exact else "NOT EXACT"
        over = f", {line.overrun} cut short" if line.overrun else ""
        over += f", {line.before} before the port was open" if line.before else ""
        console.print(
            f"{line.device}: {line.sent} {line.unit} sent{over}, {line.received} received: {word}"
        )
    missing = sum(abs(off) for off in books.missing.values())
    console.print(
        f"{books.ledgers} ledgers in {books.heartbeats} heartbeats: {books.wrong} do not add up; "
        f"numbers neither in the record nor named lost: {missing} "
        f"(before the recorder began: {sum(books.early.values())})",
        soft_wrap=True,
    )
    for title, counts in (("lost or not used", books.losses), ("events", books.events)):
        told = ", ".join(f"{' '.join(which)} {n}" for which, n in counts.most_common(40))
        console.print(f"{title}: {told or 'none'}", soft_wrap=True)
    again = ", ".join(f"{name} {n}" for name, n in books.restarts.items())
    console.print(f"processes that were replaced: {again or 'none'}")


def _played_s(case: Case, found: Found) -> float:
    """What the devices played of the vehicle's time: less where the machine is too busy."""
    return found.books.made("imu", "samples") / case.imu_hz


def _print_stages(console: Console, found: Found) -> None:
    table = Table(box=None, pad_edge=False, collapse_padding=True)
    for column in ("node", "stage", "unit", "received", "delivered", "dropped", "pending"):
        left = column in ("node", "stage", "unit")
        table.add_column(column, justify="left" if left else "right")
    for node, beat in sorted(found.books.last.items()):
        for stage in beat.stages:
            counts = (stage.received, stage.delivered, stage.dropped, stage.pending)
            table.add_row(node, stage.stage, stage.unit, *map(str, counts))
    console.print(table, "")
