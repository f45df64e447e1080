"""Rank 7: complete jobs on real or realistic data: a model and a scenario each."""
