"""Generated protobuf classes. `python -m tramstream.proto.generate` makes them anew."""
