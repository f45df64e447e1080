"""Rank 9: a page on this machine that shows a filter at work, and never holds it up."""
