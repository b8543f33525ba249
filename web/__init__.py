"""A page that shows a vehicle while it rides: read only, served where it runs, with nothing from outside."""
