"""What is said where nothing comes, or nothing that can be read; and the patience that ends a run then."""

import time

from motes.core.checks import refuse
from motes.live.counts import LOG

SILENCE = 10.0
"""Seconds without a message until that is said, and then after twice as long, and so on."""


class Silence:
    """Watches over the time since the last message of a source."""

    def __init__(self, source: str, patience: float):
        """Begin to listen to a source, by its name; with a patience of so many seconds, 0 for ever."""
        self._source, self._patience = source, patience
        self.broken()

    def broken(self) -> None:
        """Note that a message came."""
        self._heard, self._told_after, self._unread = time.monotonic(), SILENCE, 0

    def goes_on(self, now: float, unread: int) -> None:
        """Say that nothing comes that can be read, or end where patience does.

        Args:
            now: seconds of the monotonic clock.
            unread: how many came since the last call that could not be read.

        Raises:
            MotesError: nothing came for as long as there is patience.
        """
        seconds = now - self._heard
        self._unread += unread
        if self._patience and seconds > self._patience:
            refuse(f"source {self._source}", f"a message within {self._patience:g} s",
                   f"{self._unread} that could not be read" if self._unread else "none",
                   "Is it sent there? Set patience = 0 to wait for ever.")  # fmt: skip
        if seconds <= self._told_after:
            return
        if self._unread:
            LOG.warning("%d messages came from %s for %.0f s, and none could be read.", self._unread, self._source, seconds)
        else:
            LOG.warning("nothing has come from %s for %.0f s.", self._source, seconds)
        self._told_after *= 2
