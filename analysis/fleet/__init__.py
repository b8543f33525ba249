"""Many records of many vehicles: which they are, one table of what was found, what has changed."""
