"""Rank 1: probability laws, and laws given a state (what dynamics and sensors are)."""
