"""The ADIS16465's frames to batches of inertial samples."""
