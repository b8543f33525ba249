"""What comes on a vehicle's keys, counted and put into rows, for terminal and page alike."""
