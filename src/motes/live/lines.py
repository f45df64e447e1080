"""Lines of standard input, a file, or a serial line."""

import os
import select
import stat
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from motes.io.files import foreign, known_by, reject
from motes.live.counts import LOG
from motes.live.message import LONGEST, Form, Unreadable, parsed
from motes.live.source import Received, TextSource

PIECE = 1 << 16
"""Bytes that are read at a time."""
AGAIN = (0.5, 1.0, 2.0, 5.0)
"""Seconds until a line that was broken is opened again, and so on."""


class Lines(TextSource):
    """Lines of an open file; those of a plain file have positions. What is not read waits there."""

    waits = True

    def __init__(self, name: str, form: Form, file: int):
        """Read from an open file, by its number, which is closed in the end."""
        super().__init__(name, form)
        self._file, self._rest = file, b""
        self.repeats = stat.S_ISREG(os.fstat(file).st_mode)
        self._at = os.lseek(file, 0, os.SEEK_CUR) if self.repeats else 0
        self._ended = False

    def receive(self, timeout: float) -> Sequence[Received] | None:
        """Return lines; the last one may lack its end."""
        if self._ended:
            return None
        if not self.repeats and not select.select([self._file], [], [], timeout)[0]:
            return []
        piece = os.read(self._file, PIECE)
        if not piece:
            self._ended = True
            return self._last()
        return self._cut(piece)

    def _last(self) -> Sequence[Received] | None:
        """Return the last line where it has no end and is whole all the same: an object of JSON; half a number looks like a whole one."""
        if not self._rest.strip():
            return None
        # half a line may end as a whole one does
        with suppress(Unreadable):
            if parsed(self._rest) is not None:
                return self._cut(b"\n")
        LOG.warning("%s: the last line has no end and is left out%s.", self.name, " until it has one" if self.repeats else "")
        return None

    def _cut(self, piece: bytes) -> Sequence[Received]:
        *lines, self._rest = (self._rest + piece).split(b"\n")
        if len(self._rest) > 2 * LONGEST:
            # no line ends so late: what follows is its rest
            lines.append(self._rest)
            self._rest = b""
        found = []
        for line in lines:
            self._at += len(line) + 1
            found.append((line, self._at if self.repeats else None, None))
        return found

    def go_on(self, position: int) -> None:
        """Begin at a byte of a plain file."""
        if self.repeats:
            self._at, self._rest = os.lseek(self._file, position, os.SEEK_SET), b""

    def mark(self, position: int) -> str | None:
        """Return a digest of the last bytes before a position of a plain file, without the end of the line, which may still be missing."""
        if not self.repeats:
            return None
        return known_by(self._file, position)

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)


def of_file(path: str, form: Form) -> Lines:
    """Open a file of lines.

    Raises:
        FileError: it cannot be read.
    """
    with foreign(path, "a file of JSON lines that can be read"):
        if Path(path).is_dir():
            reject(path, "a file of JSON lines", "a folder")
        return Lines(path, form, os.open(path, os.O_RDONLY))


class Serial(TextSource):
    """Lines of a serial line, which is opened again where it is broken."""

    def __init__(self, name: str, form: Form, path: str, baud: int):
        """Open a device.

        Raises:
            FileError: it cannot be opened, or has no such speed.
        """
        super().__init__(name, form)
        self._path, self._baud, self._tries, self._next = path, baud, 0, 0.0
        with foreign(path, "a serial line that can be opened"):
            self._lines: Lines | None = self._opened()

    def _opened(self) -> Lines:
        import termios
        import tty

        speed = getattr(termios, f"B{self._baud}", None)
        if speed is None:
            reject(self._path, "a usual speed, such as ?baud=9600 or 115200", f"{self._baud}")
        file = os.open(self._path, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            if os.isatty(file):
                # what has come already stays
                tty.setraw(file, termios.TCSANOW)
                settings = termios.tcgetattr(file)
                settings[4] = settings[5] = speed
                termios.tcsetattr(file, termios.TCSANOW, settings)
        except termios.error as reason:
            # it broke in between
            os.close(file)
            raise OSError(*reason.args) from None
        return Lines(self.name, self.form, file)

    def receive(self, timeout: float) -> Sequence[Received] | None:
        """Return lines; a broken line is opened again, later and later."""
        if self._lines is None:
            time.sleep(min(timeout, max(0.0, self._next - time.monotonic())))
            if time.monotonic() < self._next:
                return []
            try:
                self._lines = self._opened()
            except OSError as reason:
                return self._broken(reason.strerror or str(reason))
            self.counts.add("reconnected", f"{self.name}: connected again.")
            self._tries = 0
        try:
            found = self._lines.receive(timeout)
        except OSError as reason:
            return self._broken(reason.strerror or str(reason))
        arrived = time.monotonic()
        return self._broken("the line was closed") if found is None else [(text, None, arrived) for text, _, _ in found]

    def _broken(self, why: str) -> list[Received]:
        if self._lines is not None:
            LOG.warning("%s: %s; it is opened again when it is there.", self.name, why)
        self.close()
        self._lines = None
        self._next = time.monotonic() + AGAIN[min(self._tries, len(AGAIN) - 1)]
        self._tries += 1
        return []

    def close(self) -> None:
        """Close the line."""
        if self._lines is not None:
            self._lines.close()
