"""The processors over a record again, without a bus, compared with what ran live."""
