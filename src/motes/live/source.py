"""What a source of messages is; those of text share how lines become messages."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

from motes.io.files import reject
from motes.live.counts import Counts
from motes.live.message import Early, Form, Message, Unreadable


class Source(ABC):
    """Where messages come from. `receive` is called by one thread, again and again, `understood` by that of the filter.

    Attributes:
        name: as the user gave it.
        counts: what came of its messages.
        position: where to go on after what was `understood` last, message or not; None where that cannot be said.
    """

    waits: ClassVar[bool] = False
    """Whether what is not read at once waits where it comes from; otherwise it is read by a thread of its own, so that nothing is lost."""
    was_read: ClassVar[str] = "the file that was read up to byte"
    """What it is known as, before a position."""
    is_over: ClassVar[bool] = False
    """Whether nothing can be added to what has ended."""
    repeats: bool = False
    """Whether what was read can be read again, from a position on."""

    def __init__(self, name: str):
        """Take the name, and count from nothing."""
        self.name, self.counts = name, Counts()
        self.position: int | None = None

    @abstractmethod
    def receive(self, timeout: float) -> Sequence[Any] | None:
        """Return what came as it came, waiting so many seconds at most for something; None where nothing will come any more."""

    @abstractmethod
    def understood(self, received: Any) -> Message | None:
        """Return the message that something received is; None where it is none, which is counted."""

    @abstractmethod
    def message(self, content: Any) -> Message:
        """Make a message once more of its content, as a checkpoint has it."""

    def go_on(self, position: int) -> None:  # noqa: B027 (most cannot)
        """Begin at what was once the `position`."""

    def mark(self, position: int) -> Any:
        """Return what the source is known by at a position, as JSON can hold it; None where there is nothing."""
        return None

    def check(self, position: int, mark: Any) -> None:
        """See to it that the source is the one that had this mark at a position.

        Raises:
            FileError: it is another, or was cut.
        """
        if mark is not None and self.mark(position) != mark:
            reject(self.name, f"{self.was_read} {position}", "another one, or one that was cut",
                   "Give that one, or set resume = false (--live.no-resume) to begin anew with this one.")  # fmt: skip

    def remember(self, last: Any) -> None:  # noqa: B027 (most need not)
        """Go on as after a message with this content, which a checkpoint kept."""

    def close(self) -> None:  # noqa: B027 (some have nothing to close)
        """Give back what is open."""


Received = tuple[bytes, int | None, float | None]
"""A text, where the source goes on after it, and when it arrived."""


class TextSource(Source):
    """A source of lines or datagrams; subclasses write `receive`."""

    def __init__(self, name: str, form: Form):
        """Take name and form of the messages."""
        super().__init__(name)
        self.form = form

    @abstractmethod
    def receive(self, timeout: float) -> Sequence[Received] | None:
        """Return the texts that came."""

    def understood(self, received: Received) -> Message | None:
        """Read a text."""
        text, self.position, arrived = received
        if not text.strip():
            return None
        try:
            return self.form.read(text, arrived)
        except Unreadable as reason:
            self.counts.add("early" if isinstance(reason, Early) else "unreadable", f"{self.name}: {reason}.")
            return None

    def message(self, content: Any) -> Message:
        """Make a message of an object."""
        return self.form.message(content)

    def remember(self, last: Any) -> None:
        """Take back the inputs that held."""
        self.form.held = {name: last[name] for name in self.form.needed if name in last}
