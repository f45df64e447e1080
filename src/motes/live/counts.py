"""What came of the messages of a live run: counted, told in words at the end, and in the log where it happens."""

import logging
from collections import Counter
from typing import Any

LOG = logging.getLogger("motes.live")
WORDS = {
    "steps": "{} taken",
    "inputs": "{} with inputs alone",
    "early": "{} before the first inputs",
    "duplicates": "{} came before and were dropped",
    "late": "{} late, taken at their place",
    "dropped": "{} too late, dropped",
    "sorted": "{} late, brought in order while they waited",
    "backward": "{} whose time was before that of the one before",
    "wild": "{} with a number far ahead of the time, dropped",
    "jumps": "{} jumps of the clock",
    "unreadable": "{} not readable",
    "refused": "{} refused by the model",
    "collapsed": "{} that no particle explained",
    "overrun": "{} lost because they came faster than the filter takes them",
    "left": "{} had come and were not taken when it was told to end",
    "missing": "{} numbers never came",
    "reconnected": "{} times connected again",
}
"""Kinds of events, in the order in which they are told."""


class Counts:
    """Counts events by kind.

    Attributes:
        of: how many there were of each kind.
    """

    def __init__(self) -> None:
        """Count from nothing."""
        self.of: Counter[str] = Counter()

    def add(self, kind: str, why: str = "", number: int = 1) -> None:
        """Count an event; the first of a kind is logged with its reason, and then the tenth, the hundredth and so on.

        Args:
            kind: one of `WORDS`.
            why: what happened; nothing is logged where it is empty.
            number: of events.
        """
        before = self.of[kind]
        self.of[kind] = before + number
        if why and (before == 0 or len(str(self.of[kind])) > len(str(before))):
            LOG.warning("%s%s", why, "" if self.of[kind] == 1 else f" ({self.of[kind]} such by now)")

    def told(self) -> str:
        """Say in one line what came of all messages."""
        found = [text.format(self.of[kind]) for kind, text in WORDS.items() if self.of[kind]]
        return "messages: " + ("; ".join(found) if found else "none came") + "."

    def kept(self) -> dict[str, Any]:
        """Return the counts as JSON can hold them."""
        return dict(self.of)
