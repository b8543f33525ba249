"""Stops, turns and places on lines: simulated rides judged, lines learned, tables of records."""
