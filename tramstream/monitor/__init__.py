"""What comes on a vehicle's keys, counted and put into rows, for whoever shows it: terminal or page."""
