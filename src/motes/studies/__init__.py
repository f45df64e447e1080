"""Rank 6: many runs of several filters, paired, stored, and told in tables."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
