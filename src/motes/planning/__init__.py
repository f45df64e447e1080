"""Rank 7: which filter, which partition, how many particles: costs and pilot studies together."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
