"""Rank 4: one file per filter, the loop and the stream that drive them."""

from motes.filters import keep as keep
