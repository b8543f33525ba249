"""The localiser `tram`: states, motion, measurements, modes."""
