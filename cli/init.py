"""`tramstream init [DIR]`: a vehicle configuration to start from, with every field explained."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

CONFIG_NAME = "tram.toml"
DBC_NAME = "tram.dbc"


def init(
    folder: Annotated[
        Path, typer.Argument(metavar="[DIR]", help="Where to write tram.toml and tram.dbc.")
    ] = Path(),
    force: Annotated[
        bool, typer.Option("--force", help="Overwrite a tram.toml that is there already.")
    ] = False,
) -> None:
    """Write a commented vehicle configuration, and the DBC that it names as an example.

    A DBC that is there already is never touched.
    """
    from importlib.resources import files

    from tramstream.cli.terminal.session import say
    from tramstream.errors import ConfigError

    config, dbc = folder / CONFIG_NAME, folder / DBC_NAME
    if config.exists() and not force:
        raise ConfigError(
            f"{config}: exists already; name another folder, or say --force to overwrite it"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        config.write_text(template())
        say(f"{config}: written; all fields are in it, those with a # in front have that default")
        if dbc.exists():
            say(f"{dbc}: kept as it is")
        else:
            dbc.write_bytes((files("tramstream") / "data" / DBC_NAME).read_bytes())
            say(f"{dbc}: written; it is the simulated tram's: put your vehicle's in its place")
    except OSError as error:
        raise ConfigError(
            f"{folder}: cannot be written ({error.strerror}); name a folder that you may write"
        ) from error
    ports = sorted(Path("/dev/serial/by-id").glob("*"))
    if ports:
        say("serial devices here, for gnss.device and imu.device:")
        for port in ports:
            say(f"  {port}")
    say(f"next: change vehicle, devices and wheels in it, then `tramstream doctor {config}`")


def template() -> str:
    """The configuration that `init` writes: every setting of every section, with its default."""
    from tramstream.config import Vehicle
    from tramstream.config_file import SECTIONS
    from tramstream.settings_file import scalars, section, settings_of

    parts = [HEAD, scalars(Vehicle, EXAMPLE, without=[SECTIONS])]
    for setting in settings_of(Vehicle):
        if setting.section is None or setting.name == "calibrated":  # written by the loader
            continue
        if setting.name in HEADINGS:
            group = BEFORE.get(setting.name)
            parts += [*(_strangers(group) if group else ()), _heading(HEADINGS[setting.name])]
        example, commented = (
            EXAMPLE.get(setting.name, setting.default or {}),
            setting.name in COMMENTED,
        )
        sections = {setting.name: example}
        if setting.shape == "named":
            sections = {f"{setting.name}.{name}": each for name, each in example.items()}
        parts += [
            section(name, setting.section, values, commented=commented)
            for name, values in sections.items()
        ]
    return "\n".join(parts)


def _strangers(group: str) -> list[str]:
    """Sections of bridges or processors of other packages, which run only if the user says so."""
    from tramstream import plugins
    from tramstream.config import Vehicle
    from tramstream.settings_file import section

    found = []
    for name in plugins.names(group):
        if name in Vehicle.__struct_fields__:
            continue
        settings = getattr(plugins.load(group, name), "Settings", None)
        if settings is not None:
            ours = settings.__module__.startswith("tramstream.")
            when = WHEN_OURS if ours else WHEN[group]
            found.append(f"# {when}\n{section(name, settings, commented=True)}")
    return found


def _heading(text: str) -> str:
    return f"\n# {text} ".ljust(101, "-") + "\n"


HEAD = """\
# Configuration of one vehicle.
#
# Change first: vehicle, gnss.device, imu.device, odometer.channel, odometer.dbc, odometer.wheels.
# Then run `tramstream doctor tram.toml`, which checks all of it, and `tramstream run tram.toml`.
#
# Lines that begin with `#name =` show a default; take the # away to change it. Beside it stands
# what it may be. A field that does not exist is refused. Units stand in the names: _m, _s, _hz,
# _mps … Paths are relative to this file. A section that is left out ([gnss], [imu] or [odometer])
# leaves the device out.
"""
HEADINGS = {
    "gnss": "Devices",
    "resampler": "Processors",
    "recorder": "Record",
    "simulators": "Simulated devices",
}
"""What stands above a section, of it and of those that follow."""
BEFORE = {"resampler": "bridges", "recorder": "processors"}
"""Headings before which the sections of other packages have their place."""
WHEN = {
    "bridges": "Of another package; it runs if this section is there.",
    "processors": "Of another package; it runs if `processors` above names it.",
}
WHEN_OURS = "Not among those of every vehicle; it runs if `processors` above names it."
EXAMPLE: dict[str, Any] = {
    "vehicle": "tram-1",
    "gnss": {
        "device": "/dev/serial/by-id/usb-u-blox_AG_-_www.u-blox.com_u-blox_GNSS_receiver-if00"
    },
    "imu": {"device": "/dev/serial/by-id/usb-tramstream_imu-if00"},
    "odometer": {
        "channel": "can0",
        "dbc": DBC_NAME,
        "wheels": {
            "left": {"message": "WHEELS", "signal": "PULSES_LEFT", "kind": "pulses"},
            "right": {"message": "WHEELS", "signal": "PULSES_RIGHT", "kind": "pulses"},
        },
        "doors_open": {"message": "DOORS", "signal": "DOORS_OPEN"},
        "motor_force_n": {"message": "DRIVE", "signal": "MOTOR_FORCE"},
    },
    "map": {"network": "network.tracks"},
    "simulators": {"ride": {"kind": "ride", "link": "/tmp/ride"}},
}
"""What has no default: the reference vehicle's devices, and the wheels of the example DBC."""
COMMENTED = ("map", "simulators")
"""Sections that the example does without."""
