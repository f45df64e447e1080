"""Rank 7: which filter, which partition, how many particles: costs and pilot studies together."""
