"""Pages to look at: a ride, a network, a match; each one file that asks no network."""
