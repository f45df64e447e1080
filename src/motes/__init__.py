"""Motes: Monte Carlo state estimation. The public names are listed in `__init__.pyi`; each is imported when first used."""

import lazy_loader

from motes.core.kept import keep_programs

keep_programs()
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
