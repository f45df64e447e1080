"""Rank 5: what a run tells of its own trustworthiness."""
