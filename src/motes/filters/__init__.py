"""Rank 4: one file per filter, the loop and the stream that drive them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
