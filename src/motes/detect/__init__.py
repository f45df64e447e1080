"""Rank 5: whether, when and since when what is measured follows another model."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
