"""Studies over many rides: what accuracy is reached, and what no filter can do better."""
