"""The localisation filter as a processor: which model, which map, which messages."""
