"""What a page asks, and what it is told: a header of JSON, then rows (float64), then the moment in whole numbers of 16 and 8 bits."""

import json
from typing import Any, NamedTuple

from motes.report.film import Frame
from motes.report.parts import rounded
from motes.report.scene import encoded
from motes.watch.recorder import Recorder


class Question(NamedTuple):
    """What a page wants.

    Attributes:
        axes: two coordinates; -1 is the time.
        have: number of the newest moment that it has; -1 for none.
        at: number of a moment that is past; None for the newest.
        by: so many moments after or before that.
        generation: of its rows.
        rows: how many of them it has.
        state: of the run, as it knows it.
    """

    axes: tuple[int, int] = (0, 1)
    have: int = -1
    at: int | None = None
    by: int = 0
    generation: int = -1
    rows: int = 0
    state: str = ""


class Answers:
    """Makes the answers; those about the newest moment once for all pages."""

    def __init__(self, recorder: Recorder, title: str):
        """Answer from what a recorder has."""
        self.recorder, self.title = recorder, title
        self.state = "live"
        self.report: str | None = None
        self._picture: bytes | None = None
        self._made: dict[tuple[int, int, tuple[int, int]], tuple[dict[str, Any], bytes]] = {}

    def described(self) -> dict[str, Any]:
        """Return what a page is told once."""
        recorder = self.recorder
        return recorder.scene.described() | {"run": self.title, "budget": recorder.budget,
                                             "columns": list(recorder.columns)}  # fmt: skip

    def picture(self) -> bytes | None:
        """Return the picture that stands behind all moments, as PNG; None where there is none."""
        if self._picture is None and self.recorder.scene.picture is not None:
            self._picture = encoded(self.recorder.scene.picture, "PNG")
        return self._picture

    def understood(self, text: str) -> Question | None:
        """Return the question of a page; None of what is none."""
        try:
            given = json.loads(text)
            asked = Question(**{name: given[name] for name in Question._fields if name in given})
        except (ValueError, TypeError, RecursionError):
            return None
        most = len(self.recorder.scene.names)
        whole = (asked.have, asked.by, asked.generation, asked.rows, *([] if asked.at is None else [asked.at]))
        if not all(type(one) is int and abs(one) < 2**53 for one in whole) or not isinstance(asked.state, str):
            return None
        axes = asked.axes
        if not isinstance(axes, list) or len(axes) != 2 or not all(type(axis) is int and -1 <= axis < most for axis in axes):
            return None
        return asked._replace(axes=(axes[0], axes[1]))

    def has_news(self, asked: Question) -> bool:
        """Tell whether there is something that the page does not know."""
        newest = self.recorder.newest
        return asked.at is not None or (newest is not None and newest.number != asked.have) or asked.state != self.state

    def to(self, asked: Question) -> bytes:
        """Return the answer to a question."""
        recorder = self.recorder
        with recorder.lock:
            newest = recorder.newest
            shown = newest if asked.at is None else recorder.reel.near(asked.at, asked.by)
            if shown is not None and asked.at is None and shown.number == asked.have:
                shown = None
            same = asked.generation == recorder.generation and 0 <= asked.rows <= recorder.count
            begin = asked.rows if same else 0
            rows = recorder.rows[begin : recorder.count].astype("<f8").tobytes()
            header: dict[str, Any] = {
                "rows": {"generation": recorder.generation, "from": begin, "count": recorder.count - begin},
                "reel": recorder.reel.reach, "state": self.state, "report": self.report is not None, "late": recorder.late,
                "filter": recorder.label, "taken": recorder.taken, "log_likelihood": rounded(recorder.log_likelihood),
                "findings": [{"name": one.name, "text": f"{one.text} {one.advice}", "serious": bool(one.serious)}
                             for one in recorder.findings],
                "told": list(recorder.told),
            }  # fmt: skip
        body = b""
        if shown is not None:
            drawn, body = self._moment(shown, asked.axes)
            header |= {"frame": drawn, "live": asked.at is None}
        text = json.dumps(header, allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        return b"".join([len(text).to_bytes(4, "little"), text, rows, body])

    def _moment(self, shown: Frame, axes: tuple[int, int]) -> tuple[dict[str, Any], bytes]:
        key = (shown.number, shown.points.shape[1], axes)
        if key not in self._made:
            # pages that look at the same share the newest few
            for oldest in list(self._made)[:-4]:
                self._made.pop(oldest)
            header, body = shown.along(axes)
            self._made[key] = (header | {"picture": len(shown.picture)}, body + shown.picture)
        return self._made[key]
