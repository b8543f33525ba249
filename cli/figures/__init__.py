"""What `bench`, `reproduce` and `evaluate` measure and print."""
