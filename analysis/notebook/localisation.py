"""The processors over a record from Python: other settings, the same code as on the vehicle."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tramstream import boundary, config_file
from tramstream.analysis.notebook.record import PathLike, Record, open_record
from tramstream.analysis.notebook.rides import made, place_for
from tramstream.config import Vehicle
from tramstream.errors import LeftOutWarning, RecordError
from tramstream.recorder.reprocess.run import Rerun, rerun, vehicle_of

Settings = Mapping[str, Any] | PathLike | Vehicle
"""Changes to the record's configuration by section, a TOML file, or a whole configuration."""


def localise(
    record: Record | PathLike,
    settings: Settings | None = None,
    *,
    smooth: bool = False,
    out: PathLike | None = None,
) -> Record:
    """Run the processors over a record or a simulated ride; give what they make as a record.

    Parameters
    ----------
    record : Record, str or path
    settings : mapping, str, path or Vehicle, optional
        `{"ekf": {"model": "kaspar2023"}}` changes the record's own configuration, a path names a
        TOML file (`tramstream init` writes one). None: the record's own, and the estimates are
        those of the live run. With settings the processors begin afresh at the first message and
        use what came late, instead of what the live run had read and remembered.
    smooth : bool
        Add `est/ekf/smoothed`: states that know the whole ride. Takes 0.6 GB of memory an hour.
    out : str or path, optional
        Where the record is kept; else in a temporary folder that goes with it.

    Raises
    ------
    ConfigError
        If the settings cannot be used; the sentence names the field.
    RecordError
        If the record holds no inputs of the processors, or `out` exists.
    """
    source = record if isinstance(record, Record) else open_record(record)
    if source.place is None:
        raise RecordError(
            f"{source.reader.paths[0]}: is one of several files; open the folder that holds them"
        )
    chosen = None if settings is None else configured(source, settings)
    target, folder = place_for(out, "estimates.mcap")
    done = rerun(source.place, target, chosen, fresh=chosen is not None, smooth=smooth)
    for sentence in _shortfalls(source.place, done):
        warnings.warn(sentence, LeftOutWarning, stacklevel=2)
    return made(target, folder, source)


def configured(record: Record, settings: Settings) -> Vehicle:
    """The configuration that `settings` mean for `record`; paths are relative to this process.

    Raises
    ------
    ConfigError
    """
    if isinstance(settings, Vehicle):
        return settings
    if isinstance(settings, str | os.PathLike):
        return config_file.load(Path(settings).expanduser())
    own = json.loads(config_file.to_json(vehicle_of(record.reader, record.reader.paths[0])))
    own |= own.pop(config_file.SECTIONS)  # in a file they stand under their names
    text = "\n".join(
        f"{json.dumps(str(name))} = {_toml(value)}"
        for name, value in _merged(own, settings).items()
        if value is not None
    )
    return config_file.parse(text.encode(), "settings", Path.cwd())


def _merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """`base` with `changes`, section by section; None takes a section away."""
    merged = dict(base)
    for name, value in changes.items():
        own = merged.get(name)
        both = isinstance(own, Mapping) and isinstance(value, Mapping)
        merged[name] = _merged(own, value) if both else value  # type: ignore[arg-type]
    return merged


def _toml(value: Any) -> str:
    """A value as TOML, so that one loader checks all configurations."""
    if isinstance(value, Mapping):
        pairs = (f"{json.dumps(str(k))} = {_toml(v)}" for k, v in value.items() if v is not None)
        return f"{{{', '.join(pairs)}}}"
    if hasattr(value, "tolist"):  # of numpy
        value = value.tolist()
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, bool | int | float):
        return str(value).lower()
    return json.dumps(str(value), ensure_ascii=False)


def _shortfalls(place: Path, done: Rerun) -> list[str]:
    """Sentences about what the processors had to do without."""
    told = [
        f"{place}: {count} messages on {path} that the live processors read are not in the record"
        for path, count in done.missing.items()
    ]
    if done.undecodable:
        told.append(f"{place}: {boundary.left_out(done.undecodable.items())}, as live")
    if done.without_map:
        told.append(
            f"{done.without_map}; localisation went on without the map; give "
            'settings={"map": {"network": …}}'
        )
    return told
