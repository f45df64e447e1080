"""Messages that come twice, late, out of order, or from a clock that was set: where each has its place, or that it has none."""

import heapq
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

from motes.core.checks import refuse
from motes.io.instants import SAME
from motes.live.counts import LOG, Counts
from motes.live.message import Message
from motes.live.settings import Live

REMEMBERED = 1000
"""Messages among which one is a duplicate."""
STUBBORN = 20
"""So many messages in a row that are all too late come from a clock that was set back, or a source that began anew."""


class Placed(NamedTuple):
    """A message that is to be taken.

    Attributes:
        message: what came.
        time: seconds of a clock that was never set; None where it has none.
        back: how many of the last steps come after it.
        anew: whether the filter is to begin anew with it.
    """

    message: Message
    time: float | None
    back: int = 0
    anew: bool = False


class Order:
    """The rule for the order of messages, and the last ones that were taken.

    Attributes:
        window: those of the last steps, `lag + 1` at most, the present one last.
        offset: what is added to times, seconds, since clocks were set.
    """

    def __init__(self, settings: Live, counts: Counts):
        """Begin before the first message."""
        self.settings, self.counts = settings, counts
        self.lag = settings.lag if settings.late == "fold in" else 0
        self.window: deque[Placed] = deque(maxlen=self.lag + 1)
        self.offset = 0.0
        self._seen: deque[tuple[float, int]] = deque(maxlen=REMEMBERED)
        self._known: set[tuple[float, int]] = set()
        self._waiting: list[tuple[float, int, Message]] = []
        self._came = self._stubborn = 0
        self._usual = 0.0
        self._arrived: float | None = None
        self._newest: float | None = None

    def take(self, message: Message) -> Iterable[Placed]:
        """Give what is to be taken now that a message came, each once the one before was; with "wait" it may be others than this one.

        Raises:
            MotesError: the clock of the source was set, and the run is to end then.
        """
        if self.settings.duplicate == "drop" and self._is_known(message):
            self.counts.add("duplicates", f"{_called(message)} came before and is dropped.")
            return []
        if self.settings.late != "wait" or message.time is None:
            placed = self._placed(message)
            return [] if placed is None else [placed]
        self._came += 1
        if self._newest is not None and self._newest - self.settings.jump < message.time < self._newest:
            self.counts.add("sorted")
        self._newest = message.time if self._newest is None or message.time < self._newest - self.settings.jump else max(
            self._newest, message.time)  # fmt: skip
        heapq.heappush(self._waiting, (message.time, self._came, message))
        return self._due(self._newest - self.settings.wait)

    def rest(self) -> Iterable[Placed]:
        """Give what still waits, in order; where a source has ended."""
        return self._due(float("inf"))

    def taken(self, placed: Placed) -> None:
        """Note that a message was taken, after all that are to come before it."""
        self.window.append(placed)

    def since(self, placed: Placed) -> float | None:
        """Return the seconds from the last step to one that comes next; 0 for the first; None where they are not known."""
        if placed.time is None:
            return None
        before = self.window[-1].time if self.window else placed.time
        return 0.0 if before is None else placed.time - before

    def back(self, steps: int) -> list[Placed]:
        """Take the last steps back, and return them in order."""
        return [self.window.pop() for _ in range(steps)][::-1]

    def settle(self) -> None:
        """Forget all steps but the present one: none of them can be gone back to."""
        present = self.window[-1]
        self.window.clear()
        self.window.append(present)

    def kept(self) -> dict[str, Any]:
        """Return what a checkpoint keeps, as JSON can hold it."""
        return {"window": [(one.message.content, one.message.number, one.time) for one in self.window], "offset": self.offset,
                "usual": self._usual, "waiting": [message.content for _, _, message in self._waiting], "newest": self._newest,
                "seen": list(self._seen)}  # fmt: skip

    def go_on(self, kept: dict[str, Any], message: Callable[[Any], Message]) -> list[Placed]:
        """Take back what a checkpoint kept, but for the last steps, which it returns: the first was taken before the checkpoint.

        Args:
            kept: by `kept`.
            message: makes a message of its content.
        """
        self.offset, self._usual, self._newest = kept["offset"], kept["usual"], kept["newest"]
        for content in kept["waiting"]:
            self._came += 1
            waits = message(content)
            assert waits.time is not None
            heapq.heappush(self._waiting, (waits.time, self._came, waits))
        self._seen.extend((mark, digest) for mark, digest in kept["seen"])
        self._known = set(self._seen)
        return [Placed(message(content)._replace(number=number), time) for content, number, time in kept["window"]]

    def _due(self, until: float) -> Iterator[Placed]:
        while self._waiting and self._waiting[0][0] <= until:
            placed = self._placed(heapq.heappop(self._waiting)[2])
            if placed is not None:
                yield placed

    def _is_known(self, message: Message) -> bool:
        mark = message.number if message.number is not None else message.time
        if mark is None:
            return False
        # two sensors may measure at one time: the same is what says the same
        key = (mark, 0 if message.number is not None else zlib.crc32(repr(message.content).encode()))
        if key in self._known:
            return True
        if len(self._seen) == REMEMBERED:
            self._known.discard(self._seen[0])
        self._seen.append(key)
        self._known.add(key)
        return False

    def _placed(self, message: Message) -> Placed | None:
        time = None if message.time is None else message.time + self.offset
        arrived, self._arrived = self._arrived, message.arrived
        if not self.window:
            return Placed(message, time)
        last = self.window[-1]
        if time is not None and last.time is not None:
            passed = time - last.time
            gone = float("inf") if message.arrived is None or arrived is None else message.arrived - arrived
            if passed < -self.settings.jump or passed - gone > self.settings.jump:
                return self._jumped(message, passed)
        back = self._later(message, time)
        if back == 0:
            if time is not None and last.time is not None and time > last.time:
                self._usual = time - last.time
            if message.number is not None and last.message.number is not None and message.number > last.message.number + 1:
                self.counts.add("missing", number=message.number - last.message.number - 1)
            self._stubborn = 0
            return Placed(message, time)
        if back < len(self.window):
            self._stubborn = 0
            if message.number is not None and self.counts.of["missing"]:
                self.counts.of["missing"] -= 1
            self.counts.add("late", f"{_called(message)} came late and is taken at its place, {back} steps back.")
            return Placed(message, time, back)
        self._stubborn += 1
        if self._stubborn >= STUBBORN:
            self._stubborn = 0
            return self._jumped(message, 0.0 if time is None or last.time is None else time - last.time)
        self.counts.add("dropped", f"{_called(message)} came too late and is dropped.")
        return None

    def _later(self, message: Message, time: float | None) -> int:
        """Return how many of the last steps come after a message."""
        by_number = message.number is not None
        found = 0
        for placed in reversed(self.window):
            if by_number and placed.message.number is not None:
                later = placed.message.number > message.number  # type: ignore[operator]
            else:
                later = time is not None and placed.time is not None and placed.time > time + SAME
            if not later:
                break
            found += 1
        return found

    def _jumped(self, message: Message, passed: float) -> Placed:
        way = f"{abs(passed):.3g} s {'ahead' if passed > 0 else 'back'}"
        said = f"the clock of the source went {way} at {_called(message)}"
        if self.settings.clock_jump == "stop":
            refuse("live clock_jump", f"times within {self.settings.jump:g} s", f"{way} at {_called(message)}",
                   'Set clock_jump = "bridge" or "begin anew" to go on.')  # fmt: skip
        last = self.window[-1].time
        self._seen.clear()
        self._known.clear()
        if self.settings.clock_jump == "begin anew":
            self.counts.add("jumps", f"{said}: the filter begins anew.")
            self.offset = 0.0
            self.window.clear()
            return Placed(message, message.time, anew=True)
        self.counts.add("jumps", f"{said}: it counts as the usual step of {self._usual:.3g} s.")
        if message.time is not None and last is not None:
            self.offset = last + self._usual - message.time
        time = None if message.time is None else message.time + self.offset
        # what came before the jump cannot be told from what is late after it
        self.settle()
        present = self.window[-1]
        self.window[-1] = present._replace(message=present.message._replace(number=None))
        LOG.debug("times are shifted by %g s", self.offset)
        return Placed(message, time)


def _called(message: Message) -> str:
    if message.number is not None:
        return f"message {message.number}"
    return "a message" if message.time is None else f"the message of {message.time!r:.30} s"
