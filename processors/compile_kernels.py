"""Compiles every kernel that a vehicle uses: `python -m tramstream.processors.compile_kernels`.

A short simulated ride goes through the resampler and the localisation filter, as messages would on
the vehicle; what no such ride meets is called by hand.
"""

from __future__ import annotations

from tramstream import machine_code, scenario
from tramstream.config import Ekf, Vehicle
from tramstream.line import built_in_line
from tramstream.processor import Processor
from tramstream.processors.distance import DistanceFilter
from tramstream.processors.ekf import LocalisationFilter
from tramstream.processors.resampler import Resampler
from tramstream.processors.tram_filter import TramFilter, parameters
from tramstream.simulation import Simulation

RIDE_S = 50.0
"""Standing, departure, alignment, a curve."""


def compile_all() -> None:
    """Call all kernels once."""
    simulation = Simulation(built_in_line(), scenario.load("city"), 1, RIDE_S)
    vehicle = simulation.vehicle
    resampler = Resampler(vehicle)
    processors: list[Processor] = [DistanceFilter(vehicle), LocalisationFilter(vehicle)]
    for sent in simulation.samples():
        if sent.key not in resampler.inputs:
            continue
        for made in resampler.step(sent):
            for processor in processors:
                if made.key in processor.inputs:
                    processor.step(made)
    ekf = TramFilter(parameters(Vehicle(vehicle="none", ekf=Ekf()), 9.81))
    ekf.rim(0, 0.0, 1.0)
    ekf.velocity((0.0, 0.0), 1.0)


if __name__ == "__main__":
    machine_code.clear()
    compile_all()
    machine_code.mark_complete()
