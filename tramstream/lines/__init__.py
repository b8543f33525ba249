"""Curves along which a tram rides, by arc length, and the files that hold them."""
