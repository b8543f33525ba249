"""Calibration at the desk: what an inertial sensor's readings of standstill tell of its noise."""
