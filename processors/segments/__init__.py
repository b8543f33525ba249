"""Stops, turns and the place on a line from inertial data and wheels alone, beside the filter."""
