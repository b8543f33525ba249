"""Errors of an estimate against the truth, and whether the filter knows its own."""
