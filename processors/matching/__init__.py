"""The map matcher: which run of a track network the vehicle is on, and where."""
