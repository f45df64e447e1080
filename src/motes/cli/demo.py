"""`motes demo [NAME]`: fly a demonstration; each is a module of its own with `main(words)`."""

import importlib
from collections.abc import Sequence

from motes.cli.options import refuse

DEMOS = {"terrain": "motes.cli.demo_terrain", "robot": "motes.cli.demo_robot"}
"""Name of each demonstration to its module; the first is flown when none is named."""


def main(words: Sequence[str]) -> None:
    """Hand over to the demonstration that is named.

    Raises:
        MotesError: there is no such demonstration, or it refuses its options.
    """
    name, rest = (words[0], words[1:]) if words and not words[0].startswith("-") else (next(iter(DEMOS)), words)
    if name not in DEMOS:
        refuse("demo", "one of " + ", ".join(DEMOS), repr(name))
    importlib.import_module(DEMOS[name]).main(rest)
