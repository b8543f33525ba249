"""How well the slope and the mass are found: rides whose slope is known, in several worlds."""
