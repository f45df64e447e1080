"""Rank 8: reports as web pages; one file each, which needs no network. The folder uplot holds uPlot 1.6.32 by Leon Sorokin (MIT)."""
