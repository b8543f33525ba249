"""2 kHz to 100 Hz: samples ordered, averaged, and put into frames."""
