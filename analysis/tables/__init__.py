"""Other people's tables and captures as the raw messages of a ride."""
