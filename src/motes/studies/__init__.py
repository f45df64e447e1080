"""Rank 6: many runs of several filters, paired, stored, and told in tables."""
