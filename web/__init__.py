"""A page that shows a vehicle while it rides: read only, with nothing from outside."""
