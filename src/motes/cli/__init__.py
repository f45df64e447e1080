"""Rank 8: the command line."""
