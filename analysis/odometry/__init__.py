"""Wheel constants, antenna, delays and slip periods out of ordinary rides."""
