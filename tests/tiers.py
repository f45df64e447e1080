"""Which tests run when: `make test` leaves those marked `night` to `make night`, in which some tests ask more, too."""

import os

import pytest

NIGHT = bool(os.environ.get("MOTES_NIGHTLY"))
"""Whether this is a run of `make night`."""


def but_one_in(values, step):
    """Names of all values but every so-many-th one: what is asked of many alike is asked of the others by night."""
    return {str(value) for place, value in enumerate(values) if place % step}


def each(values, night=()):
    """Parameters for `parametrize`: values, or those of a dictionary with its keys as ids.

    What `night` names, or says of a name that it is so, is asked by night.
    """
    names = values if isinstance(values, dict) else {str(value): value for value in values}
    late = night if callable(night) else night.__contains__
    return [pytest.param(value, id=str(name), marks=[pytest.mark.night] * bool(late(name))) for name, value in names.items()]
