"""One TOML file per vehicle: what is refused, and with which words."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from tramstream import config
from tramstream.config import Vehicle
from tramstream.config_file import load, parse
from tramstream.errors import ConfigError
from tramstream.private import default_runtime_dir

FULL = """
vehicle = "tram-9001"
[bus]
runtime_dir = "run"
[gnss]
device = "/dev/gnss"
lever_arm_m = [1.5, 0, 3.25]
[imu]
device = "links/imu"
[odometer]
channel = "can0"
dbc = "tram.dbc"
[odometer.wheels.left]
message = "WHEELS"
signal = "LEFT"
kind = "pulses"
[resampler]
cutoff_hz = 10
[recorder]
directory = "/var/records"
[simulators.ride]
kind = "ride"
link = "links/sim"
"""


def refused(text: str) -> str:
    """The sentence that `text` is refused with."""
    with pytest.raises(ConfigError) as caught:
        parse(text.encode(), "tram.toml", Path("/etc/tram"))
    assert str(caught.value).startswith("tram.toml: ")
    return str(caught.value)


def test_every_default_loads() -> None:
    vehicle = parse(b'vehicle = "t"', "t", Path("/"))
    assert msgspec.convert(msgspec.to_builtins(vehicle), Vehicle) == vehicle
    assert vehicle.gnss is vehicle.imu is vehicle.odometer is None


def test_every_section_loads_with_its_required_fields_alone() -> None:
    vehicle = parse(FULL.encode(), "t", Path("/etc/tram"))
    assert vehicle.gnss is not None
    assert vehicle.gnss.lever_arm_m == (1.5, 0.0, 3.25)
    assert vehicle.resampler.cutoff_hz == 10.0
    assert vehicle.odometer is not None
    assert vehicle.odometer.wheels["left"].kind == "pulses"


def test_relative_paths_are_relative_to_the_file() -> None:
    vehicle = parse(FULL.encode(), "t", Path("/etc/tram"))
    assert vehicle.imu is not None
    assert vehicle.gnss is not None
    assert vehicle.odometer is not None
    assert vehicle.imu.device == "/etc/tram/links/imu"
    assert vehicle.odometer.dbc == "/etc/tram/tram.dbc"
    assert vehicle.simulators["ride"].link == "/etc/tram/links/sim"
    assert vehicle.simulators["ride"].file == ""
    assert vehicle.runtime_dir == Path("/etc/tram/run")


def test_absolute_paths_and_names_of_interfaces_stay() -> None:
    vehicle = parse(FULL.encode(), "t", Path("/etc/tram"))
    assert vehicle.gnss is not None
    assert vehicle.odometer is not None
    assert vehicle.gnss.device == "/dev/gnss"
    assert vehicle.odometer.channel == "can0"
    assert vehicle.recorder.directory == "/var/records"
    far = parse(FULL.replace("can0", "ws://host/can").encode(), "t", Path("/etc/tram"))
    assert far.odometer is not None
    assert far.odometer.channel == "ws://host/can"


def test_load_reads_the_file_and_resolves_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "tram.toml"
    path.write_text('vehicle = "t"\n[recorder]\ndirectory = "r"\n')
    assert load(path).recorder.directory == str(tmp_path / "r")


def test_absent_file_is_named_with_the_cure(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="tramstream init") as caught:
        load(tmp_path / "none.toml")
    assert str(tmp_path / "none.toml") in str(caught.value)


@pytest.mark.parametrize(
    ("text", "path", "nearest"),
    [
        ("[gnss]\ndevice = 'x'\nbaudrate = 9600", "$.gnss.baudrate", "baud_rate"),
        ("[imu]\ndevice = 'x'\nrate = 1000.0", "$.imu.rate", "rate_hz"),
        ("[simulators.a]\nkind = 'ride'\nlnk = 'x'", "$.simulators.a.lnk", "link"),
        ("[recorders]\n", "$.recorders", "recorder"),
        (
            "[odometer]\nchannel='c'\ndbc='d'\n[odometer.wheels.l]\nmessage='m'\nsignl='s'",
            "$.odometer.wheels.l.signl",
            "signal",
        ),
    ],
)
def test_unknown_field_is_refused_with_its_path_and_the_nearest_known_one(
    text: str, path: str, nearest: str
) -> None:
    sentence = refused(f'vehicle = "t"\n{text}')
    assert f"{path}: unknown field; did you mean {nearest}" in sentence


def test_unknown_field_that_is_near_to_none_gets_the_list() -> None:
    sentence = refused('vehicle = "t"\n[distance]\nzzz = 1')
    assert "did you mean" not in sentence
    for name in config.Distance.__struct_fields__:
        assert name in sentence


@pytest.mark.parametrize(
    ("text", "path", "words"),
    [
        ("[gnss]\ndevice = 'x'\nbaud_rate = 'fast'", "$.gnss.baud_rate", "int"),
        ("[gnss]\ndevice = 5", "$.gnss.device", "str"),
        ("[gnss]\n", "$.gnss", "device"),
        ("[gnss]\ndevice = 'x'\nlever_arm_m = [1.0]", "$.gnss.lever_arm_m", "length 3"),
        ("[imu]\ndevice = 'x'\nmodel = 'ADXL345'", "$.imu.model", "ADXL345"),
        ("[imu]\ndevice = 'x'\nbatch = 0", "$.imu.batch", ">= 1"),
        ("[resampler]\nimu_silence_s = -1.0", "$.resampler.imu_silence_s", "> 0"),
        ("[resampler]\nhorizon_lag_s = nan", "$.resampler.horizon_lag_s", "finite"),
        ("[gnss]\ndevice = 'x'\nlever_arm_m = [0, inf, 0]", "$.gnss.lever_arm_m[1]", "finite"),
        ("[recorder]\nflush_s = 5.0", "$.recorder.flush_s", "<= 0.5"),
    ],
)
def test_wrong_value_is_refused_with_its_path(text: str, path: str, words: str) -> None:
    sentence = refused(f'vehicle = "t"\n{text}')
    assert path in sentence
    assert words in sentence


def test_wrong_choice_is_refused_with_the_choices_and_the_nearest() -> None:
    assert refused('vehicle = "t"\n[ekf]\nmodel = "trm"').endswith(
        "$.ekf.model: 'trm' is none of the choices; did you mean tram? there are: kaspar2023, tram"
    )


def test_what_is_still_to_be_filled_in_is_refused_with_its_path() -> None:
    assert "$.gnss.baud_rate: is still to be filled in" in refused(
        'vehicle = "t"\n[gnss]\ndevice = "x"\nbaud_rate = "FILL IN"'
    )


@pytest.mark.parametrize("name", ["", "a b", "a/b", "*", "-a", "ü", "a" * 65])
def test_vehicle_that_no_key_can_hold_is_refused(name: str) -> None:
    assert "$.vehicle" in refused(f'vehicle = "{name}"')


@pytest.mark.parametrize("data", [b"vehicle =", b"\xff", b"[", b"vehicle = 'a'\nvehicle = 'b'"])
def test_what_is_no_toml_is_refused(data: bytes) -> None:
    with pytest.raises(ConfigError, match=r"tram\.toml: not TOML"):
        parse(data, "tram.toml", Path("/"))


def test_runtime_folder_is_the_environments_choice_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TRAMSTREAM_RUNTIME_DIR", "/tmp/chosen")
    assert default_runtime_dir() == Path("/tmp/chosen")
    assert Vehicle(vehicle="t").runtime_dir == Path("/tmp/chosen")


def test_runtime_folder_of_a_user_is_the_users_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TRAMSTREAM_RUNTIME_DIR", raising=False)
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/run/user/1000")
    assert default_runtime_dir() == Path("/run/user/1000/tramstream")
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert default_runtime_dir() == Path("/tmp/tramstream-1000")
    monkeypatch.setattr("os.geteuid", lambda: 0)
    assert default_runtime_dir() == Path("/run/tramstream")


def test_files_that_a_processors_section_names_are_relative_to_the_configuration(
    tmp_path: Path,
) -> None:
    path = tmp_path / "tram.toml"
    path.write_text(
        'vehicle = "t1"\nprocessors = ["resampler", "segments"]\n'
        '[segments]\nsignatures = ["lines/7.npz", "/srv/20.npz"]\n'
    )
    found = load(path).sections["segments"]["signatures"]
    assert found == [str(tmp_path / "lines" / "7.npz"), "/srv/20.npz"]
