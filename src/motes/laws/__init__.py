"""Rank 1: probability laws, and laws given a state (what dynamics and sensors are)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
