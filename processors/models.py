"""Localisation filters by the name that the configuration gives them, `ekf.model`."""

from __future__ import annotations

from collections.abc import Callable

from tramstream.config import Vehicle
from tramstream.localisation import Localiser
from tramstream.processors.kaspar2023 import Kaspar2023Localiser
from tramstream.processors.tram import TramLocaliser

MODELS: dict[str, Callable[[Vehicle], Localiser]] = {
    TramLocaliser.name: TramLocaliser,
    Kaspar2023Localiser.name: Kaspar2023Localiser,
}


def localiser(vehicle: Vehicle) -> Localiser:
    """Build the filter that the configuration asks for."""
    return MODELS[vehicle.ekf.model](vehicle)
