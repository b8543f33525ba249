"""Memory of stages: one dataclass each, copied, assigned in place, and kept as plain data."""
