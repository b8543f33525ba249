"""Localisation filters by the name that the configuration gives them, `ekf.model`."""

from __future__ import annotations

from collections.abc import Callable

from tramstream.config import Vehicle
from tramstream.errors import ConfigError
from tramstream.estimation.localiser import Localiser
from tramstream.processors.kaspar2023.localiser import Kaspar2023Localiser
from tramstream.processors.smoothing.trace import Tracer
from tramstream.processors.tram.localiser import TramLocaliser

MODELS: dict[str, Callable[[Vehicle], Localiser]] = {
    TramLocaliser.name: TramLocaliser,
    Kaspar2023Localiser.name: Kaspar2023Localiser,
}


def localiser(vehicle: Vehicle) -> Localiser:
    """Build the filter that the configuration asks for."""
    return MODELS[vehicle.ekf.model](vehicle)


def traced(vehicle: Vehicle, tracer: Tracer) -> Localiser:
    """Build the same filter with somebody who writes down what a smoother needs.

    Raises
    ------
    ConfigError
        If the model has no smoother.
    """
    if vehicle.ekf.model != TramLocaliser.name:
        raise ConfigError(
            f"$.ekf.model: {vehicle.ekf.model} has no smoother; "
            f"{TramLocaliser.name} is the model that has one"
        )
    return TramLocaliser(vehicle, tracer)
