"""Rank 1: what is known of a function from its traced program: whether it equals another, in what it is affine, how it is translated."""
