"""Desk work: evaluation, tables, reports, studies. Nothing here ever runs on a vehicle."""
