"""Rank 9: the command line."""
