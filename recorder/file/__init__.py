"""One file of a record: its bytes, their way to the disk, and how damage is repaired."""
