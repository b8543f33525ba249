"""Track networks out of maps: rails, stops and heights read, joined, smoothed, surveyed."""
