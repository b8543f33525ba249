"""Messages as plain data."""

from __future__ import annotations

import json

from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

from tramstream import keys
from tramstream.cli.terminal.plain import to_dict
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.health_pb2 import DeviceHealth
from tramstream.proto.raw_pb2 import ImuBatch, Odometry, RawBytes, WheelReading
from tramstream.proto.sync_pb2 import ImuMean, SyncFrame


def test_numbers_stay_numbers_also_the_large_ones() -> None:
    plain = to_dict(ImuMean(stamp_ns=2**63 + 1, accel_z_mps2=9.81))
    assert plain["stamp_ns"] == 2**63 + 1
    assert plain["accel_z_mps2"] == 9.81


def test_fields_come_in_the_order_of_their_numbers() -> None:
    names = [field.name for field in ImuMean.DESCRIPTOR.fields]
    assert list(to_dict(ImuMean())) == names


def test_unset_optional_fields_are_left_out_and_set_zeros_are_not() -> None:
    assert "pulses" not in to_dict(WheelReading(wheel="left"))
    assert to_dict(WheelReading(wheel="left", pulses=0))["pulses"] == 0
    assert "imu" not in to_dict(SyncFrame())


def test_enumerations_become_names_and_unknown_ones_numbers() -> None:
    assert to_dict(GnssFix(fix_type=GnssFix.FIX_3D))["fix_type"] == "FIX_3D"
    assert to_dict(GnssFix(fix_type=77))["fix_type"] == 77  # type: ignore[arg-type]


def test_bytes_become_hexadecimal() -> None:
    assert to_dict(RawBytes(data=b"\xb5\x62"))["data"] == "b562"


def test_nested_repeated_and_mapped_fields_are_lists_and_dicts() -> None:
    odometry = Odometry(wheels=[WheelReading(wheel="left", pulses=3)])
    assert to_dict(odometry)["wheels"] == [{"wheel": "left", "pulses": 3}]
    assert to_dict(ImuBatch(gyro_x=[1, -2]))["gyro_x"] == [1, -2]
    health = DeviceHealth(rejected_by_reason={"checksum": 2})
    assert to_dict(health)["rejected_by_reason"] == {"checksum": 2}


def test_foxglove_timestamps_are_kept_whole() -> None:
    location = LocationFix()
    location.timestamp.FromNanoseconds(1_700_000_000_123_456_789)
    assert to_dict(location)["timestamp"] == {"seconds": 1_700_000_000, "nanos": 123_456_789}


def test_every_message_of_the_bus_is_json_afterwards() -> None:
    for key in keys.ALL:
        assert isinstance(json.dumps(to_dict(key.type())), str)
