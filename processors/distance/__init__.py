"""Travelled distance and speed from wheels and GNSS speed (konecny2004)."""
