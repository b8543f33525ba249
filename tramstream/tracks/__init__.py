"""The track network as a vehicle uses it: read, checked, evaluated beside a place."""
