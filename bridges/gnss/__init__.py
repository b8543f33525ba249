"""A GNSS receiver's bytes to fixes: UBX and NMEA framing, messages, clocks."""
