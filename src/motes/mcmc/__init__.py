"""Rank 5: Markov chains without time: one file per kernel, the loop that drives them, what their draws are worth."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
