"""Rank 3: what functions make of a Gaussian: rules for its moments, by slopes or by sigma points, and their use mode by mode."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
