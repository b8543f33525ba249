"""Geodesy against identities and against printed tables."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tramstream import geodesy
from tramstream.geodesy import C_nl, LocalLevel, convergence_rad

MM = 1e-3  # m
MICROMETRE = 1e-6  # m
NANORADIAN = 1e-9  # rad; 6 mm on the ground

# IOGP Publication 373-7-2 (EPSG Guidance Note 7-2), examples of methods 9602 and 9836.
EPSG_GEODETIC = np.array(
    [np.radians(53 + 48 / 60 + 33.820 / 3600), np.radians(2 + 7 / 60 + 46.380 / 3600), 73.0]
)
EPSG_P_E = np.array([3771793.968, 140253.342, 5124304.349])
EPSG_ORIGIN_E = np.array([3652755.3058, 319574.6799, 5201547.3536])
EPSG_P_L = np.array([-189013.869, -128642.040, -4220.171])

latitudes = st.floats(-np.pi / 2, np.pi / 2)
longitudes = st.floats(-np.pi, np.pi)
heights = st.floats(-1000.0, 9000.0)


def test_epsg_example_gives_the_printed_earth_fixed_position() -> None:
    assert geodesy.ecef_from_geodetic(EPSG_GEODETIC) == pytest.approx(EPSG_P_E, abs=MM)


def test_epsg_example_gives_the_printed_geodetic_position() -> None:
    geodetic = geodesy.geodetic_from_ecef(EPSG_P_E)
    assert geodetic[:2] == pytest.approx(EPSG_GEODETIC[:2], abs=NANORADIAN)
    assert geodetic[2] == pytest.approx(73.0, abs=MM)


def test_epsg_example_gives_the_printed_local_level_position() -> None:
    level = LocalLevel(*geodesy.geodetic_from_ecef(EPSG_ORIGIN_E))
    assert level.from_geodetic(EPSG_GEODETIC) == pytest.approx(EPSG_P_L, abs=MM)


@given(latitudes, longitudes, heights)
def test_one_place_is_where_its_row_is(latitude: float, longitude: float, height: float) -> None:
    level = LocalLevel.at_deg(50.0, 14.4, 250.0)
    row = level.from_geodetic((latitude, longitude, height))
    assert level.place(latitude, longitude, height) == pytest.approx(row, abs=MICROMETRE)


def test_epsg_topocentric_origin_is_55_north_5_east_200_metres() -> None:
    level = LocalLevel.at_deg(55.0, 5.0, 200.0)
    assert level.origin_e == pytest.approx(EPSG_ORIGIN_E, abs=0.1 * MM)


def test_gravity_at_equator_and_pole_is_that_of_tr8350_2() -> None:
    # NIMA TR8350.2, third edition, table 3.4
    assert geodesy.normal_gravity_mps2(0.0, 0.0) == pytest.approx(9.7803253359, abs=1e-10)
    assert geodesy.normal_gravity_mps2(np.pi / 2, 0.0) == pytest.approx(9.8321849378, abs=1e-9)


def test_gravity_near_prague_is_the_one_theory_names() -> None:
    # docs/theory.md, section 2.3: 9.81009 near Prague
    gravity = geodesy.normal_gravity_mps2(np.radians(50.08), 250.0)
    assert gravity == pytest.approx(9.81009, abs=1e-4)


def test_gravity_falls_by_the_free_air_gradient() -> None:
    # 0.3086 mGal/m, Torge, Geodesy, 4th edition, eq. 4.56
    fall = geodesy.normal_gravity_mps2(0.8, 0.0) - geodesy.normal_gravity_mps2(0.8, 100.0)
    assert fall == pytest.approx(100 * 0.3086e-5, rel=1e-3)


@given(latitudes, longitudes, heights)
def test_geodetic_survives_earth_fixed_and_back(lat: float, lon: float, height: float) -> None:
    p_e = geodesy.ecef_from_geodetic([lat, lon, height])
    back = geodesy.geodetic_from_ecef(p_e)
    assert back[0] == pytest.approx(lat, abs=1e-3 * NANORADIAN)
    assert back[2] == pytest.approx(height, abs=MICROMETRE)
    assert geodesy.ecef_from_geodetic(back) == pytest.approx(p_e, abs=MICROMETRE)


@given(latitudes, longitudes, heights)
def test_local_level_survives_geodetic_and_back(lat: float, lon: float, height: float) -> None:
    level = LocalLevel(lat, lon, height)
    p_l = np.array([[0.0, 0.0, 0.0], [1000.0, -2000.0, 30.0], [-5.0, 12000.0, -80.0]])
    back = level.from_geodetic(level.to_geodetic(p_l))
    np.testing.assert_allclose(back, p_l, atol=10 * MICROMETRE)


@given(latitudes, longitudes)
def test_local_level_frame_is_a_right_handed_rotation(lat: float, lon: float) -> None:
    C_le = LocalLevel(lat, lon, 0.0).C_le
    np.testing.assert_allclose(C_le @ C_le.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(C_le) == pytest.approx(1.0, abs=1e-14)


def test_one_row_and_many_rows_give_the_same_numbers() -> None:
    many = np.array([EPSG_GEODETIC, [0.1, -2.0, 5.0]])
    p_e = geodesy.ecef_from_geodetic(many)
    assert p_e.shape == (2, 3)
    np.testing.assert_array_equal(p_e[0], geodesy.ecef_from_geodetic(many[0]))
    np.testing.assert_array_equal(
        geodesy.geodetic_from_ecef(p_e)[1], geodesy.geodetic_from_ecef(p_e[1])
    )


def test_frame_of_a_local_level_cannot_be_edited() -> None:
    level = LocalLevel.at_deg(50.0, 14.0, 0.0)
    with pytest.raises(ValueError, match="read-only"):
        level.C_le[0, 0] = 1.0


# Axes of places in a level frame ------------------------------------------------------------------
@given(latitudes, longitudes, st.floats(-1e5, 1e5), st.floats(-1e5, 1e5))
def test_axes_of_a_place_are_those_of_a_level_laid_there(
    lat: float, lon: float, east: float, north: float
) -> None:
    level = LocalLevel(lat, lon, 100.0)
    p_l = np.array([east, north, 50.0])
    place = LocalLevel(*level.to_geodetic(p_l).tolist())
    axes = C_nl(level, level.to_geodetic(p_l))
    np.testing.assert_allclose(axes, place.C_le @ level.C_le.T, atol=1e-12)
    # 10 km up, where the tangent plane of 140 km leaves the ground, the shape tells less.
    np.testing.assert_allclose(level.up_l(p_l), axes[2], atol=2e-6)
    if abs(lat) < 1.5:
        along = axes[0] / np.hypot(axes[0, 0], axes[0, 1])
        angle = float(convergence_rad(level, place.longitude_rad))
        np.testing.assert_allclose(along[:2], [np.cos(angle), np.sin(angle)], atol=1e-9)
