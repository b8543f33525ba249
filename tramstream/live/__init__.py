"""A processor or bridge as a node on the bus: the one loop, its host, its devices, its memory."""
