"""The model `tram`, compiled: states, motion, one file for each thing that is measured."""
