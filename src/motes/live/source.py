"""What a source of messages is; those of text share how lines become messages."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

from motes.live.counts import Counts
from motes.live.message import Early, Form, Message, Unreadable


class Source(ABC):
    """Where messages come from. `read` is called by one thread, again and again.

    Attributes:
        name: as the user gave it.
        counts: what came of its messages.
    """

    waits: ClassVar[bool] = False
    """Whether what is not read at once waits where it comes from; otherwise it is read by a thread of its own, so that nothing is lost."""
    is_over: ClassVar[bool] = False
    """Whether nothing can be added to what has ended."""
    repeats: bool = False
    """Whether what was read can be read again, from the position of a message on."""

    def __init__(self, name: str):
        """Take the name, and count from nothing."""
        self.name, self.counts = name, Counts()

    @abstractmethod
    def read(self, timeout: float) -> Sequence[Message] | None:
        """Return what came, waiting so many seconds at most for something; None where nothing will come any more."""

    @abstractmethod
    def message(self, content: Any) -> Message:
        """Make a message once more of its content, as a checkpoint has it."""

    def go_on(self, position: int) -> None:  # noqa: B027 (most cannot)
        """Begin where a message said that it goes on after it."""

    def remember(self, last: Any) -> None:  # noqa: B027 (most need not)
        """Go on as after a message with this content, which a checkpoint kept."""

    def close(self) -> None:  # noqa: B027 (some have nothing to close)
        """Give back what is open."""


class TextSource(Source):
    """A source of lines or datagrams; subclasses write `texts`."""

    def __init__(self, name: str, form: Form):
        """Take name and form of the messages."""
        super().__init__(name)
        self.form = form

    @abstractmethod
    def texts(self, timeout: float) -> Sequence[tuple[bytes, int | None, float | None]] | None:
        """Return what came: text, where the source goes on after it, and when it arrived; see `read`."""

    def read(self, timeout: float) -> Sequence[Message] | None:
        """Read what came; what is no message is counted."""
        found = self.texts(timeout)
        return None if found is None else [one for text in found if (one := self._read(*text)) is not None]

    def _read(self, text: bytes, position: int | None, arrived: float | None) -> Message | None:
        if not text.strip():
            return None
        try:
            return self.form.read(text, position, arrived)
        except Unreadable as reason:
            self.counts.add("early" if isinstance(reason, Early) else "unreadable", f"{self.name}: {reason}.")
            return None

    def message(self, content: Any) -> Message:
        """Make a message of an object."""
        return self.form.message(content)

    def remember(self, last: Any) -> None:
        """Take back the inputs that held."""
        self.form.held = {name: last[name] for name in self.form.needed if name in last}
