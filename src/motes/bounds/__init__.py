"""Rank 5: how good any filter could be."""
