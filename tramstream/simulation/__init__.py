"""Simulated rides with their truth: motion, sensors, and what goes wrong with them."""
