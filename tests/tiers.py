"""Which tests run when: `make test` leaves those marked `night` to `make night`, in which some tests ask more, too."""

import os

import pytest

NIGHT = bool(os.environ.get("MOTES_NIGHTLY"))
"""Whether this is a run of `make night`."""


def each(values, night=()):
    """Parameters for `parametrize`: values, or those of a dictionary with its keys as ids; what `night` names is asked by night."""
    names = values if isinstance(values, dict) else {str(value): value for value in values}
    return [pytest.param(value, id=str(name), marks=[pytest.mark.night] * (name in night)) for name, value in names.items()]
