"""A captured minute through a running vehicle for a day: what is lost, and what grows."""
