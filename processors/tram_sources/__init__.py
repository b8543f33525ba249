"""What each source tells the filter `tram`: fixes, wheels, inertial readings; and who errs."""
