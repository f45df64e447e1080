"""Rank 0: records, arrays of particles and the random stream; knows nothing of estimation."""
