"""Recorded data that tests may use (too large for the repository), and the form that every refusal has."""

from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / ".." / "shared" / "data"


def recorded(name: str) -> Path:
    path = FOLDER / name
    if not path.is_file():
        pytest.skip(f"recorded data {name} is not beside the repository")
    return path


def refused(error: pytest.ExceptionInfo, *words: object) -> None:
    """Assert that a refusal is one short line that holds all these words."""
    message = str(error.value)
    assert len(message) <= 500 and message.isprintable(), message
    for word in words:
        assert str(word) in message, (word, message)
