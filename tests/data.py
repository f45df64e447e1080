"""Where the recorded data lie that tests may use; they are too large for the repository."""

from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / ".." / "shared" / "data"


def recorded(name: str) -> Path:
    path = FOLDER / name
    if not path.is_file():
        pytest.skip(f"recorded data {name} is not beside the repository")
    return path
