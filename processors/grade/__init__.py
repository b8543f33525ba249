"""The slope of the track under the vehicle, apart from its body's nod, and distances to stop."""
