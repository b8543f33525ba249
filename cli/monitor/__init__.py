"""A vehicle or a record in a terminal: messages, figures of keys, the screen of `top`."""
