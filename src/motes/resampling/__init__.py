"""Rank 2: how ancestors are drawn (schemes) and when (policy)."""
