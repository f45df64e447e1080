"""Rank 7: pictures; with `report` the only importer of matplotlib."""
