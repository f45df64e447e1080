"""Rank 1: small recorded data that come with the package, so that what is shown runs as it stands."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
