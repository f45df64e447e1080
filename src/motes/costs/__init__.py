"""Rank 5: what a filter costs, counted in operations and measured in seconds."""
