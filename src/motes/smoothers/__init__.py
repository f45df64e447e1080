"""Rank 5: laws of past states given all measurements."""
