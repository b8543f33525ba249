"""CAN frames to wheel readings: sockets, slcan lines, signals of a DBC."""
