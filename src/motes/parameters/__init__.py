"""Rank 7: parameters of state-space models: which values, from the likelihoods of filters and from chains."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
