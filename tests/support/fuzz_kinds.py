"""The kinds of files that verbs read, each with files to begin with and what verbs make of one."""

from __future__ import annotations

import json
import random
import struct
import tempfile
from itertools import islice
from pathlib import Path

import numpy as np
from fuzz_grades import GRADE_KINDS
from fuzzing import Kind, change_archive, change_bytes, change_either, change_text
from msgspec.structs import replace
from networks import town
from record_rides import CONFIG, batch, fix, wheels
from record_samples import START_NS

from tramstream import config_file, keys
from tramstream.analysis.evaluate.source import gather
from tramstream.analysis.report.source import collect
from tramstream.analysis.tables import captures
from tramstream.analysis.tables.tables import Tables
from tramstream.bridges.imu import framer as adis
from tramstream.bridges.odometer.dbc import Database
from tramstream.cli.config import config as config_verb
from tramstream.cli.echo import echo
from tramstream.cli.export import export
from tramstream.cli.info import info
from tramstream.cli.init import template
from tramstream.cli.map_info import info as map_info
from tramstream.cli.recover import recover
from tramstream.config import Gnss, Imu, Odometer, Wheel
from tramstream.errors import ConfigError
from tramstream.lines import geojson, traces
from tramstream.lines.line import built_in_line
from tramstream.live import registry
from tramstream.mapping import extract, line_requests
from tramstream.mapping.lines import lay_lines
from tramstream.proto.estimate_pb2 import MotionState
from tramstream.proto.health_pb2 import Event, NodeHealth
from tramstream.proto.raw_pb2 import TruthState
from tramstream.recorder.file.writer import RecordFile
from tramstream.recorder.reprocess.run import rerun
from tramstream.simulation import scenario
from tramstream.simulation.simulation import Simulation
from tramstream.tracks import network
from tramstream.tracks.linear_reference import references
from tramstream.tracks.rails import Search
from tramstream.tracks.run_graph import RunGraph

ROOT = Path(__file__).parents[2]
QUICK = replace(CONFIG, processors=("resampler", "distance"))
"""Everything but the filter: a step of it is compiled for long, and none of it reads files."""
DBC = """VERSION ""

BU_: ECU

BO_ 256 WHEEL_SPEEDS: 8 ECU
 SG_ WHEEL_SPEED_FL : 0|16@1+ (0.01,0) [0|655] "km/h" ECU
"""


def fresh(path: Path) -> Path:
    """A place beside `path` where nothing is."""
    out = path.with_name(f"{path.name}.out")
    for each in path.parent.glob(f"{path.name}.out*"):
        each.unlink()
    return out


# Configurations -----------------------------------------------------------------------------------
def configurations(folder: Path) -> list[bytes]:
    """That of `init`, and one in which every setting is live."""
    imu, gnss = Imu(device="/dev/imu"), Gnss(device="/dev/gnss")
    wheel = Wheel(message="WHEELS", signal="LEFT", kind="pulses")
    odometer = Odometer(interface="virtual", channel="can0", dbc="a.dbc", wheels={"left": wheel})
    whole = replace(CONFIG, imu=imu, gnss=gnss, odometer=odometer)
    return [template().replace("FILL IN", "x").encode(), config_file.to_toml(whole).encode()]


def use_configuration(path: Path) -> None:
    """As `run`, `doctor` and `reprocess --config` do before they look at devices."""
    vehicle = config_file.load(path)
    chosen = tuple(name for name in vehicle.processors if name in ("resampler", "distance"))
    registry.make_processors(replace(vehicle, processors=chosen, map=None))
    config_verb(path)
    config_file.digest(vehicle)


# Tables -------------------------------------------------------------------------------------------
IMU_CSV = """time_ms,ax,ay,az,wx,wy,wz,temp
1767261600000,0.012,-0.003,1.001,0.05,-0.11,0.20,31.5
1767261600100,0.013,-0.002,1.000,0.06,-0.10,0.21,31.5
1767261600200,0.055,-0.003,0.999,0.05,-0.12,0.25,31.5
1767261600300,0.061,-0.001,1.002,0.04,-0.11,0.24,31.5
"""
GPS_CSV = """date;time;lat;lon;height;acc;fix;kmh;course
2026-01-01;10:00:00.0;50.0755381;14.4378005;245.31;0.021;RTK;0.0;0.0
2026-01-01;10:00:00.2;50.0755381;14.4378006;245.31;0.022;RTK;0.3;88.2
2026-01-01;10:00:00.4;50.0755381;14.4378008;245.32;0.540;DGPS;0.8;89.0
"""
MAPPING = """[clock]
kind = "utc"

[[tables]]
kind = "imu"
file = "imu.csv"
time = { column = "time_ms", unit = "ms", offset_s = -0.004 }
gyro = { columns = ["wx", "wy", "wz"], unit = "deg/s" }
accel = { columns = ["ax", "ay", "az"], unit = "g" }
temperature = { column = "temp", unit = "degC" }

[[tables]]
kind = "gnss"
file = "gps.csv"
delimiter = ";"
time = { column = ["date", "time"], unit = "datetime" }
position = { frame = "geodetic", columns = ["lat", "lon", "height"], unit = "deg" }
horizontal_std = { columns = ["acc"], unit = "m" }
vertical_std = { value = 0.05, unit = "m" }
velocity = { frame = "course", columns = ["kmh", "course"], unit = "km/h" }
speed_std = { value = 0.1, unit = "m/s" }
quality = { column = "fix", fixed = ["RTK"], valid = ["RTK", "DGPS"] }
every_s = 0.4
withheld = "truth"

[vehicle]
vehicle = "example"

[vehicle.imu]
device = "imu.csv"
rate_hz = 10
batch = 5
mounting_deg = [0.0, 0.0, 90.0]

[vehicle.resampler]
factor = 1

[vehicle.gnss]
device = "gps.csv"
lever_arm_m = [1.2, 0.0, 2.9]
"""


def mappings(folder: Path) -> list[bytes]:
    (folder / "imu.csv").write_text(IMU_CSV)
    (folder / "gps.csv").write_text(GPS_CSV)
    return [MAPPING.encode()]


def use_mapping(path: Path) -> None:
    imports = captures.Imports(None, "", "ADIS16465-1")
    imports.tables(Tables(path, [str(path.parent)], []))
    imports.write(fresh(path))


def tables(folder: Path) -> list[bytes]:
    mappings(folder)
    (folder / "ride.toml").write_text(MAPPING)
    return [IMU_CSV.encode(), GPS_CSV.encode()]


def use_table(path: Path) -> None:
    """The table takes the place of the one that it was made of."""
    name = "gps.csv" if b";" in path.read_bytes()[:200] else "imu.csv"
    imports = captures.Imports(None, "", "ADIS16465-1")
    imports.tables(Tables(path.parent / "ride.toml", [f"{name}={path}"], []))
    imports.write(fresh(path))


# Scenarios, lines, maps ---------------------------------------------------------------------------
def scenarios(folder: Path) -> list[bytes]:
    data = ROOT / "tramstream" / "data" / "scenarios"
    return [each.read_bytes() for each in sorted(data.glob("*.toml"))]


def use_scenario(path: Path) -> None:
    ride = Simulation(built_in_line(), scenario.load(str(path)), 0, duration_s=0.2)
    for _ in islice(ride.samples(), 20):
        pass


def _line(count: int = 12) -> list[list[float]]:
    return [[14.42 + 3e-4 * k, 50.08 + 1e-5 * k * k, 250.0 + k] for k in range(count)]


def lines(folder: Path) -> list[bytes]:
    properties = {"line": "7", "direction": "0", "stops": ["A", "B"], "times": list(range(12))}
    line = {"type": "LineString", "coordinates": _line()}
    feature = {"type": "Feature", "properties": properties, "geometry": line}
    stop = {"type": "Point", "coordinates": [14.421, 50.0801]}
    points = {"type": "Feature", "properties": {"name": "A"}, "geometry": stop}
    whole = {"type": "FeatureCollection", "features": [feature, points]}
    return [json.dumps(each).encode() for each in (whole, feature, line)]


def use_line(path: Path) -> None:
    """As `simulate --line`, `map match` and `map build --lines` read it."""
    for read in (_lay, traces.read, line_requests.read):
        try:
            read(path)
        except Exception as error:
            if type(error).__module__ != "tramstream.errors":
                raise


def _lay(path: Path) -> None:
    geojson.lay(geojson.read(str(path)))


def gpx(folder: Path) -> list[bytes]:
    points = "".join(
        f'<trkpt lat="{lat}" lon="{lon}"><ele>{up}</ele><time>2026-01-01T10:00:{k:02d}Z</time>'
        f"<hdop>1.0</hdop></trkpt>\n"
        for k, (lon, lat, up) in enumerate(_line())
    )
    head = '<?xml version="1.0"?><gpx xmlns="http://www.topografix.com/GPX/1/1" version="1.1">'
    return [f"{head}<trk><trkseg>\n{points}</trkseg></trk></gpx>".encode()]


def osm(folder: Path) -> list[bytes]:
    nodes = [
        {"type": "node", "id": k, "lat": lat, "lon": lon, "tags": {"railway": "tram_stop"}}
        for k, (lon, lat, _) in enumerate(_line(), 1)
    ]
    tags = {"railway": "tram", "oneway": "yes", "maxspeed": "50"}
    way = {"type": "way", "id": 10, "nodes": list(range(1, 13)), "tags": tags}
    members = [{"type": "way", "ref": 10, "role": ""}, {"type": "node", "ref": 1, "role": "stop"}]
    route = {"type": "route", "route": "tram", "ref": "7"}
    relation = {"type": "relation", "id": 5, "members": members, "tags": route}
    return [json.dumps({"elements": [*nodes, way, relation]}).encode()]


def use_osm(path: Path) -> None:
    line_requests.of_extract(extract.read([path]))


# Networks -----------------------------------------------------------------------------------------
def networks(folder: Path) -> list[bytes]:
    ways = (network.Way(0, 0.0, 250.0, 4711, {"maxspeed": "50"}),)
    requests = [
        line_requests.LineRequest("9", "out", ("West", "Far", "West")),
        line_requests.LineRequest("8", "", ("Square", "Branch end")),
    ]
    lay_lines(town(ways=ways), requests)[0].save(folder / "town.tracks")
    return [(folder / "town.tracks").read_bytes()]


def use_network(path: Path) -> None:
    """As `map info`, `map match` and the matcher look into it."""
    map_info(path)
    map_info(path, as_json=True)
    known = network.load(path)
    references(known).at(0, 10.0)
    graph = RunGraph(known)
    for run in range(min(2 * known.track_count, 20)):
        known.name_of(run)
        graph.after(run)
    places = known.geodetic_of([[0.0, 0.0], [known.east[0], known.north[0]]])
    plan = known.plan_of(places)
    for east, north in plan:
        Search(known).near(float(east), float(north), 20.0)


# Records ------------------------------------------------------------------------------------------
def records(folder: Path) -> list[bytes]:
    """A short ride of inputs, estimates, truth and health; the same not finished; a foreign one."""
    path = folder / "seed.mcap"
    metadata = {config_file.RECORD_ENTRY: config_file.to_json(QUICK)}
    with RecordFile(path, "tram", metadata) as record:
        _fill(record)
    finished = path.read_bytes()
    path.unlink()
    unfinished = RecordFile(path, "tram", metadata)
    _fill(unfinished)
    unfinished.flush()
    unfinished.abandon()
    return [finished, path.with_name("seed.mcap.active").read_bytes()]


def _messages() -> list[tuple[keys.Key, int, object]]:
    sent: list[tuple[keys.Key, int, object]] = []
    for step in range(60):
        at_ns = START_NS + step * 10_000_000
        for key, every, make in (
            (keys.IMU_BATCH, 1, batch),
            (keys.ODO_WHEELS, 2, wheels),
            (keys.GNSS_FIX, 20, fix),
        ):
            if step % every == 0:
                message = make(step)
                message.stamp_ns = at_ns
                sent.append((key, at_ns, message))
        if step % 10 == 0:
            state = MotionState(stamp_ns=at_ns, latitude_deg=50.0, longitude_deg=14.4)
            state.covariance.extend([1.0] * 28)
            sent.append((keys.EST_STATE, at_ns, state))
            truth = TruthState(stamp_ns=at_ns, latitude_deg=50.0, longitude_deg=14.4)
            sent.append((keys.TRUTH_STATE, at_ns, truth))
            sent.append((keys.EVENT.at("imu"), at_ns, Event(stamp_ns=at_ns, kind="x.y")))
            sent.append((keys.HEARTBEAT.at("imu"), at_ns, NodeHealth(stamp_ns=at_ns)))
    return sent


def _fill(record: RecordFile) -> None:
    numbers: dict[str, int] = {}
    for key, at_ns, message in _messages():
        numbers[key.path] = numbers.get(key.path, 0) + 1
        payload = message.SerializeToString()  # type: ignore[attr-defined]
        record.append(key.on("tram"), key, payload, at_ns, at_ns, numbers[key.path])


CHANGING = tempfile.TemporaryDirectory(prefix="fuzz-")
"""Where records are changed message by message."""


def change_record(data: bytes, chance: random.Random) -> bytes:
    """Bytes of the file, or a file with good checksums that holds garbage."""
    if chance.random() < 0.5:
        return change_bytes(data, chance)
    path = Path(CHANGING.name) / "changed.mcap"
    path.unlink(missing_ok=True)
    text = config_file.to_json(QUICK)
    if chance.random() < 0.3:
        text = change_text(text.encode(), chance).decode("utf-8", "replace")
    metadata = {config_file.RECORD_ENTRY: text}
    if chance.random() < 0.2:
        metadata |= {
            chance.choice(("part", "schema_version", "utc_offset_ns", "session")): "9" * 40
        }
    with RecordFile(path, chance.choice(("tram", "tram", "x/y", "*")), metadata) as record:
        for key, at_ns, message in _messages():
            payload = message.SerializeToString()  # type: ignore[attr-defined]
            if chance.random() < 0.05:
                payload = change_bytes(payload, chance)
            log_ns = (
                chance.choice((0, (1 << 63) - 1, (1 << 64) - 1))
                if chance.random() < 0.01
                else at_ns
            )
            record.append(key.on("tram"), key, payload, log_ns, log_ns, chance.randrange(1 << 32))
            if chance.random() < 0.02:
                _add_special(record, chance, at_ns)
    return path.read_bytes()


def _add_special(record: RecordFile, chance: random.Random, at_ns: int) -> None:
    """What reprocessing believes of the live run: sessions, ticks, late samples, losses."""
    key = chance.choice(
        (keys.SYNC_SNAPSHOT, keys.SYNC_TICK, keys.SYNC_LATE, keys.LOSS.at("processors"))
    )
    fields: dict[str, object] = {"stamp_ns": at_ns, "sequence": chance.randrange(9)}
    message = key.type(**fields)
    if key is keys.SYNC_SNAPSHOT:
        message.start = chance.random() < 0.5
        message.session = chance.randrange(3)
        message.tick_sequence = chance.randrange(2)
        message.states.add(name="resampler", state=chance.randbytes(chance.randrange(40)))
        message.positions.add(key=keys.GNSS_FIX.path, count=chance.randrange(1 << 60))
    elif key is keys.SYNC_TICK:
        message.session = chance.randrange(3)
        message.positions.add(
            key=chance.choice((keys.GNSS_FIX.path, keys.IMU_BATCH.path, "")),
            count=chance.randrange(1 << 62),
            last_publish_ns=chance.choice((at_ns, 0, (1 << 63) - 1)),
        )
    elif key is keys.SYNC_LATE:
        message.key, message.source_publish_ns = keys.GNSS_FIX.path, at_ns
    else:
        message.key, message.consumer = keys.GNSS_FIX.on("tram"), chance.choice(("", "processors"))
        message.count = chance.randrange(1 << 40)
    payload = message.SerializeToString()
    record.append(key.on("tram"), key, payload, at_ns, at_ns, chance.randrange(9))


def use_record(path: Path) -> None:
    """As every verb reads it."""
    out = fresh(path)
    for use in (
        lambda: info([path]),
        lambda: info([path], as_json=True),
        lambda: echo("**", file=path),
        lambda: echo("**", file=path, json_=True),
        lambda: export([path], csv=out.with_suffix(".tables"), geojson=out.with_suffix(".geo")),
        lambda: recover(path, out.with_name(out.name + ".saved")),
        lambda: config_verb(path),
        lambda: gather(path, "", "", lambda text: None),
        lambda: collect(path, "", "", lambda text: None),
        lambda: rerun(path, out.with_name(out.name + ".again"), QUICK, with_inputs=True),
        lambda: rerun(path, out.with_name(out.name + ".own"), None, check=True),
    ):
        try:
            use()
        except SystemExit:
            pass
        except Exception as error:
            if type(error).__module__ != "tramstream.errors":
                raise


# Captures -----------------------------------------------------------------------------------------
def sentence(body: str) -> bytes:
    total = 0
    for byte in body.encode():
        total ^= byte
    return f"${body}*{total:02X}\r\n".encode()


def nmea(folder: Path) -> list[bytes]:
    lines = b""
    for k in range(10):
        lines += sentence(f"GPRMC,1200{k:02d}.00,A,5004.53,N,01426.26,E,1.0,0.0,090324,,,A")
        lines += sentence(f"GPGGA,1200{k:02d}.00,5004.53,N,01426.26,E,1,09,0.9,200.0,M,45.0,M,,")
        lines += sentence(f"GPZDA,1200{k:02d}.00,09,03,2024,00,00")
    return [lines]


def change_nmea(data: bytes, chance: random.Random) -> bytes:
    """Sentences with other fields and good checksums, or bytes."""
    if chance.random() < 0.3:
        return change_bytes(data, chance)
    made = b""
    for line in data.split(b"\r\n"):
        body = line[1:-3]
        if body and chance.random() < 0.3:
            body = change_text(body, chance)
        made += sentence(body.decode("latin-1").replace("\n", ""))
    return made


def ubx(folder: Path) -> list[bytes]:
    """Frames of NAV-PVT; what is in them is `change_ubx`'s."""
    return [b"".join(_ubx(1, 7, _pvt(k)) for k in range(10))]


def _pvt(k: int) -> bytes:
    head = struct.pack(
        "<IHBBBBBBIiBBBB", 475_200_000 + 200 * k, 2024, 3, 9, 12, 0, 0, 7, 30, 0, 3, 1, 0, 9
    )
    body = struct.pack(
        "<iiiiIIiiiiiIIH",
        144378005,
        500755381,
        245310,
        200000,
        900,
        1200,
        0,
        0,
        0,
        0,
        0,
        300,
        1000,
        120,
    )
    return (head + body).ljust(92, b"\0")


def _ubx(class_: int, id_: int, payload: bytes) -> bytes:
    content = bytes([class_, id_]) + struct.pack("<H", len(payload)) + payload
    a = b = 0
    for byte in content:
        a = (a + byte) & 255
        b = (b + a) & 255
    return b"\xb5\x62" + content + bytes([a, b])


def change_ubx(data: bytes, chance: random.Random) -> bytes:
    if chance.random() < 0.3:
        return change_bytes(data, chance)
    made = b""
    for k in range(10):
        class_, id_, payload = 1, 7, _pvt(k)
        if chance.random() < 0.4:
            class_ = chance.choice((1, 1, 2, 0x0D, 0x10))
            id_ = chance.choice((1, 2, 3, 4, 6, 7, 0x12, 0x14, 0x20, 0x21, 0x26, 0x35, 0x36, 0x43))
            payload = chance.randbytes(chance.choice((4, 12, 16, 20, 36, 40, 52, 84, 92, 100, 300)))
        elif chance.random() < 0.5:
            payload = change_bytes(payload, chance)[:1000]
        made += _ubx(class_, id_, payload)
    return made


def use_receiver(path: Path) -> None:
    imports = captures.Imports(None, "", "ADIS16465-1")
    imports.gnss(path)
    imports.write(fresh(path))


def candump(folder: Path) -> list[bytes]:
    (folder / "bus.dbc").write_text(DBC)
    rows = [
        f"({1000 + k / 10:.6f}) can0 100#{struct.pack('<H', 1000 + k).hex()}000000000000"
        for k in range(40)
    ]
    return [("\n".join(rows) + "\n").encode()]


def use_candump(path: Path) -> None:
    imports = captures.Imports(None, "", "ADIS16465-1")
    imports.can(path, path.parent / "bus.dbc", [])
    imports.write(fresh(path))


DBC_WHOLE = """VERSION ""

NS_ :

BS_:

BU_: ECU DOORS

BO_ 256 WHEEL_SPEEDS: 8 ECU
 SG_ WHEEL_SPEED_FL : 0|16@1+ (0.01,0) [0|655] "km/h" ECU
 SG_ WHEEL_SPEED_FR : 23|16@0- (0.01,-67.67) [0|250] "KM/H" ECU

BO_ 257 PAGES: 8 ECU
 SG_ PAGE M : 0|4@1+ (1,0) [0|15] "" ECU
 SG_ SUBPAGE m1M : 4|4@1+ (1,0) [0|15] "" ECU
 SG_ WHEEL_PULSES m2 : 8|32@1+ (1,0) [0|0] "" ECU
 SG_ WHEEL_DEEP m3 : 8|16@1+ (0.1,0) [0|0] "m/s" ECU

BO_ 2566844926 CCVS: 8 ECU
 SG_ WHEEL_BASED_SPEED : 8|16@1+ (0.00390625,0) [0|250.996] "km/h" ECU

BO_ 258 FLOATS: 16 ECU
 SG_ WHEEL_SINGLE : 0|32@1- (1,0) [0|0] "m/s" ECU
 SG_ WHEEL_DOUBLE : 64|64@1- (1,0) [0|0] "m/s" ECU

CM_ SG_ 256 WHEEL_SPEED_FL "of the rim";
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "VFrameFormat" BO_ 2566844926 2;
VAL_ 256 WHEEL_SPEED_FL 65535 "SNA" 65534 "Error" ;
SIG_VALTYPE_ 258 WHEEL_SINGLE : 1;
SIG_VALTYPE_ 258 WHEEL_DOUBLE : 2;
SG_MUL_VAL_ 257 WHEEL_DEEP SUBPAGE 1-1, 3-5;
"""
CAN_FRAMES = (
    *(bytes(range(first, first + n)) for first in (0, 1, 0x70, 0xF0) for n in (0, 1, 8, 16)),
    *(b"\xff" * 8, b"\x21\x7f" * 32),
)


def dbcs(folder: Path) -> list[bytes]:
    rows = [
        f"({1000 + k / 50:.6f}) can0 {name}#{struct.pack('<HHHH', k, 1000 + k, 65000 + k, k).hex()}"
        for k in range(20)
        for name in ("100", "101", "102", "18FEF17E")
    ]
    (folder / "bus.candump").write_text("\n".join(rows) + "\n")
    return [DBC_WHOLE.encode(), DBC.encode()]


def use_dbc(path: Path) -> None:
    """As the odometer's bridge and `import --can` do: every signal, in frames of all lengths."""
    database = Database(str(path), "--dbc")
    for message, signal in database.units():
        try:
            _, field = database.find(message, signal, "$.odometer.wheels.x")
        except ConfigError:
            continue
        for data in CAN_FRAMES:
            field.read(data, 1 / 3.6)
            field.read_counter(data)
    imports = captures.Imports(None, "", "ADIS16465-1")
    imports.can(path.parent / "bus.candump", path, [])
    imports.write(fresh(path))


def imu(folder: Path) -> list[bytes]:
    """A tenth of a second of frames, and its stamps and numbers across their wrap."""
    return [_imu_frames(0, 0), _imu_frames(2**32 - 50_000, 2**32 - 90)]


def _imu_frames(stamp_us: int, first: int, count: int = 200) -> bytes:
    number = np.arange(count)
    still = np.tile([0, 0, 3900], (count, 1))
    return adis.encode(stamp_us + 500 * number, first + number, still % 7, still)


def change_imu(data: bytes, chance: random.Random) -> bytes:
    """Bytes, or frames with good checksums that say something else."""
    if chance.random() < 0.4:
        return change_bytes(data, chance)
    made, stamp_us, number = b"", chance.choice((0, 2**32 - 5000)), chance.randrange(1 << 32)
    for _ in range(chance.choice((1, 2, 5))):
        count = chance.choice((0, 1, 2, 19, 20, 21, 100))
        made += _imu_frames(stamp_us, number, count)
        stamp_us += 500 * count + chance.choice((0, -500, 1, 500, 10_000, 3_000_000, 1 << 31))
        number += count + chance.choice((0, 0, 1, -1, 7, 2000, 1 << 31))
    if chance.random() < 0.5:
        at = chance.randrange(max(1, len(made)))
        spoilt = adis.encode([chance.randrange(1 << 32)], [chance.randrange(1 << 32)],
                             [[chance.choice((-32768, 32767, 0))] * 3], [[32767, -32768, 0]],
                             chance.choice((-32768, 32767)), chance.randrange(1 << 16))  # fmt: skip
        made = made[:at] + spoilt + made[at:]
    return made if chance.random() < 0.7 else change_bytes(made, chance)


def use_imu(path: Path) -> None:
    imports = captures.Imports(None, "", "ADIS16465-1")
    imports.imu(path)
    imports.write(fresh(path))


KINDS = (
    Kind("configuration", ".toml", configurations, use_configuration, change_text, 200),
    Kind("mapping", ".toml", mappings, use_mapping, change_text, 150),
    Kind("table", ".csv", tables, use_table, change_either, 100),
    Kind("scenario", ".toml", scenarios, use_scenario, change_text, 30),
    Kind("line", ".geojson", lines, use_line, change_text, 50),
    Kind("gpx", ".gpx", gpx, lambda path: traces.read(path) and None, change_either, 300),
    Kind("osm", ".json", osm, use_osm, change_text, 150),
    Kind("network", ".tracks", networks, use_network, change_archive, 75),
    Kind("record", ".mcap", records, use_record, change_record, 15),
    Kind("nmea", ".nmea", nmea, use_receiver, change_nmea, 75),
    Kind("ubx", ".ubx", ubx, use_receiver, change_ubx, 75),
    Kind("candump", ".candump", candump, use_candump, change_either, 75),
    Kind("dbc", ".dbc", dbcs, use_dbc, change_either, 75),
    Kind("imu", ".bin", imu, use_imu, change_imu, 75),
    *GRADE_KINDS,
)
