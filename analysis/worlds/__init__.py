"""The localisation in worlds that a simulated point does not hold, and on a day of service."""
