"""What a word that is not known was perhaps meant to be, as a hint. Imports no JAX."""

import difflib
from collections.abc import Iterable, Sequence


def meant(near: Sequence[str]) -> str:
    """Return the hint that one of some words is meant; "" for none."""
    return f"Perhaps {' or '.join(map(repr, near))} is meant." if near else ""


def perhaps(word: object, known: Iterable[str], most: int = 2) -> str:
    """Return which of some words may have been meant, at most so many, as a hint; "" where none is near."""
    return meant(difflib.get_close_matches(str(word)[:80], list(known), most, 0.6))
