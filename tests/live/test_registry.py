"""Nodes by name: every entry point is there, loads and builds."""

from __future__ import annotations

import threading
from importlib.metadata import entry_points
from pathlib import Path

import pytest
from msgspec.structs import replace

from tramstream import keys, plugins
from tramstream.config import Gnss, Imu, Recorder, Simulator, Vehicle
from tramstream.errors import ConfigError
from tramstream.live import registry
from tramstream.live.host import ProcessorNode
from tramstream.live.node import Node
from tramstream.processor import Processor
from tramstream.transport.bus import LocalBus

GROUPS = ("bridges", "ports", "processors", "nodes", "verbs")
POINTS = [
    pytest.param(group, name, id=f"{group}-{name}")
    for group in GROUPS
    for name in plugins.names(group)
]
VEHICLE = Vehicle(vehicle="t", gnss=Gnss(device="/dev/none"), imu=Imu(device="/dev/none"))


@pytest.mark.parametrize(("group", "name"), POINTS)
def test_entry_point_loads(group: str, name: str) -> None:
    assert callable(plugins.load(group, name))


def test_all_groups_have_members_and_every_bridge_its_port() -> None:
    for group in GROUPS:
        assert plugins.names(group)
    assert plugins.names("bridges") == plugins.names("ports")


def test_names_are_in_one_order_whoever_installed_us() -> None:
    for group in GROUPS:
        assert plugins.names(group) == sorted(plugins.names(group))
        points = entry_points(group=f"tramstream.{group}")
        assert {point.name for point in points} == set(plugins.names(group))


def test_unknown_name_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="no bridge is called 'lidar'; there are: gnss, imu"):
        plugins.load("bridges", "lidar")
    with pytest.raises(ConfigError, match="no node is called 'lidar'") as caught:
        registry.make_node("lidar", VEHICLE, LocalBus(), threading.Event())
    assert "recorder" in str(caught.value)


def test_processors_name_themselves_as_they_are_registered() -> None:
    for name in plugins.names("processors"):
        processor = plugins.load("processors", name)(VEHICLE)
        assert isinstance(processor, Processor)
        assert processor.name == name
        assert processor.inputs
        assert set(processor.pacing) <= set(processor.inputs)
        for key in (*processor.inputs, *processor.outputs):
            assert keys.find(key.path) == key


def test_no_two_processors_make_one_key() -> None:
    made = [key.path for each in registry.make_processors(VEHICLE) for key in each.outputs]
    assert len(made) == len(set(made))


def test_fresh_processors_restore_what_fresh_ones_remember() -> None:
    for one, other in zip(
        registry.make_processors(VEHICLE), registry.make_processors(VEHICLE), strict=True
    ):
        other.restore(one.snapshot())
        assert all(ledger.balanced for ledger in other.ledgers())


def test_configuration_chooses_the_nodes_and_router_and_recorder_come_first() -> None:
    assert registry.configured_bridges(VEHICLE) == ["gnss", "imu"]
    nodes = registry.node_names(VEHICLE)
    assert nodes[:2] == ["router", "recorder"]
    assert set(nodes) == {"router", "recorder", "processors", "gnss", "imu"}
    apart = registry.node_names(replace(VEHICLE, separate=VEHICLE.processors))
    assert set(apart) == {"router", "recorder", "gnss", "imu", *VEHICLE.running}
    one = registry.node_names(replace(VEHICLE, separate=("ekf",)))
    assert {"processors", "ekf"} < set(one)
    assert "distance" not in one
    simulated = Vehicle(vehicle="t", simulators={"ride": Simulator(kind="ride", link="/tmp/x")})
    assert "simulators" in registry.node_names(simulated)


def test_every_node_is_built_under_its_name(tmp_path: Path) -> None:
    vehicle = Vehicle(
        vehicle="t",
        gnss=Gnss(device="/dev/none"),
        imu=Imu(device="/dev/none"),
        recorder=Recorder(directory=str(tmp_path)),
    )
    apart = replace(vehicle, separate=vehicle.processors)
    names = {*registry.node_names(vehicle), *registry.node_names(apart)}
    for name in names:
        node = registry.make_node(name, vehicle, LocalBus(), threading.Event())
        assert isinstance(node, Node)
        assert node.name == name


def test_processors_share_one_node_but_for_those_with_one_of_their_own() -> None:
    for separate in ((), ("ekf",), ("resampler", "distance")):
        vehicle = replace(VEHICLE, separate=separate)
        node = registry.make_node("processors", vehicle, LocalBus(), threading.Event())
        assert isinstance(node, ProcessorNode)
        joint = [name for name in VEHICLE.running if name not in separate]
        assert [each.name for each in node.processors] == joint


@pytest.mark.parametrize("separate", [(), ("resampler",), ("resampler", "ekf", "distance")])
def test_one_node_makes_the_ticks(separate: tuple[str, ...]) -> None:
    vehicle = replace(VEHICLE, separate=separate)
    makers = []
    for name in registry.node_names(vehicle):
        node = registry.make_node(name, vehicle, LocalBus(), threading.Event())
        if isinstance(node, ProcessorNode) and keys.SYNC_TICK.path not in node.expressions():
            makers += [name] if any(keys.SYNC_TICK in p.inputs for p in node.processors) else []
    assert makers == ["resampler" if separate else "processors"]


def test_what_is_installed_and_not_named_does_not_run() -> None:
    vehicle = replace(VEHICLE, processors=("resampler",))
    assert [each.name for each in registry.make_processors(vehicle)] == ["resampler"]


def test_bridge_without_its_section_is_refused_with_the_cure() -> None:
    with pytest.raises(ConfigError, match=r"no section \[odometer\]"):
        registry.make_node("odometer", VEHICLE, LocalBus(), threading.Event())
