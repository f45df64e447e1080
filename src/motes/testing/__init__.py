"""Rank 6: the contract of a filter, asked of anyone's."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
