"""A vehicle's nodes as processes: started, watched, started again, heard."""
