"""The localiser of kaspar2023, as the work describes it."""
