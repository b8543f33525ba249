"""The whole ride known: the tape of a filter `tram`, and the smoother that goes back over it."""
