"""The checks of `doctor`: the machine, and what is plugged in."""
