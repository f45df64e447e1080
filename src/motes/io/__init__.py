"""Rank 1: bytes in and out; knows records only, never a filter."""
