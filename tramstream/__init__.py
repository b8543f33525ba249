"""Localisation stack of a tram's onboard computer.

The library: messages, keys, the bus, the one loop, clocks, the simulator. Device bytes become
messages in `tramstream.bridges`, messages become messages in `tramstream.processors`, files are
written and replayed in `tramstream.recorder`, people meet all of it in `tramstream.cli`.
"""

__version__ = "0.1.0"
