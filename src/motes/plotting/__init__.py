"""Rank 8: pictures; with `report` the only importer of matplotlib."""
