"""Looking at a vehicle or a record: messages, figures of keys, the screen of `top`."""
