"""Messages between processes: the bus, who publishes on it, what was lost and is had again."""
