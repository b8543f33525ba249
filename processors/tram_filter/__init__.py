"""The filter of the model `tram`: states, modes, events, the start; what its sources apply to."""
