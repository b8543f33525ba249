"""Simulated devices on pseudo terminals and CAN: they speak real devices' bytes."""
