"""The form of every refusal, whoever gives it."""

import pytest

from data import refused
from motes.core.checks import MotesError


def refusal(call, *words):
    """Assert that a call refuses in one short line that holds the words."""
    with pytest.raises(MotesError) as error:
        call()
    refused(error, *words)
