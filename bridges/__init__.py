"""Device bytes to messages. Parsing knows no I/O; only `ports` opens devices."""
