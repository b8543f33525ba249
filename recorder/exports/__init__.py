"""A record in files that other programs open as they are: tables, tracks, poses."""
