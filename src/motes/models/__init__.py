"""Rank 2: what the world does: state-space models, their structure, motions, sensors."""
