"""Grade maps and height rasters of strangers: files to begin with, and what verbs make of them."""

from __future__ import annotations

import io
import random
from pathlib import Path

import numpy as np
import pyarrow
import rasterio
from fuzzing import Kind, change_bytes, change_text
from graded import passing
from networks import town
from pyarrow import parquet
from rasterio.transform import from_origin

from tramstream.analysis.grade_map import file
from tramstream.analysis.grade_map.assemble import assemble, rides_of
from tramstream.analysis.grade_map.heights import Priors
from tramstream.analysis.grade_map.summary import track_grades
from tramstream.cli.grade_map_export import export
from tramstream.cli.grade_map_show import show
from tramstream.mapping import elevation, grades
from tramstream.mapping.line_requests import LineRequest
from tramstream.mapping.lines import lay_lines

NETWORK = lay_lines(town(), [LineRequest("9", "out", ("West", "Far", "West"))])[0]
NOTHING = Priors((), 0.0)
EXTREMES = (0.0, -1.0, 1e300, -1e300, float("nan"), float("inf"), 1e-310, 90.0)


def grade_maps(folder: Path) -> list[bytes]:
    rides = [passing(NETWORK, k, 1 - 2 * (k % 2)) for k in range(3)]
    file.write(assemble(NETWORK, rides, NOTHING), folder / "seed.parquet")
    return [(folder / "seed.parquet").read_bytes()]


def change_grade_map(data: bytes, chance: random.Random) -> bytes:
    """Bytes, or a sound file with other figures in it, or with another metadata text."""
    if chance.random() < 0.5:
        return change_bytes(data, chance)
    table = parquet.read_table(io.BytesIO(data))
    if chance.random() < 0.3:
        text = change_text(table.schema.metadata[file.KEY], chance)
        table = table.replace_schema_metadata({file.KEY: text})
    else:
        name = chance.choice(list(file.COLUMNS))
        column = table[name].to_numpy().copy()
        limits = np.iinfo(column.dtype) if column.dtype.kind == "i" else None
        values = EXTREMES if limits is None else (0, -1, 1, limits.max, limits.min)
        at = chance.choice((slice(None), chance.randrange(len(column))))
        column[at] = chance.choice(values)
        table = table.set_column(table.column_names.index(name), name, pyarrow.array(column))
    out = io.BytesIO()
    parquet.write_table(table, out)
    return out.getvalue()


def use_grade_map(path: Path) -> None:
    """As `grade-map show`, `export`, `build --into` and `map build --grades` read it."""
    page = path.with_suffix(".html")
    show(path, as_json=True)
    show(path, page, overwrite=True)
    texts = [path.with_suffix(end) for end in (".geojson", ".osm", ".xml")]
    export(path, *texts, overwrite=True)
    made = file.read(path)
    grades.lay(NETWORK, track_grades(made), "fuzz")
    assemble(NETWORK, rides_of(made, NETWORK), NOTHING)


def rasters(folder: Path) -> list[bytes]:
    path = folder / "seed.tif"
    profile = {"driver": "GTiff", "width": 40, "height": 40, "count": 1, "dtype": "float32"}
    profile |= {"crs": "EPSG:32633", "transform": from_origin(457000.0, 5550000.0, 100.0, 100.0)}
    with rasterio.open(path, "w", **profile) as out:
        out.write(np.full((40, 40), 250.0, np.float32), 1)
    return [path.read_bytes()]


def use_raster(path: Path) -> None:
    """As `map build --elevation` reads it."""
    elevation.lift(NETWORK, [elevation.read(path)], 44.5)


GRADE_KINDS = (
    Kind("grade map", ".parquet", grade_maps, use_grade_map, change_grade_map, 15),
    Kind("raster", ".tif", rasters, use_raster, change_bytes, 50),
)
