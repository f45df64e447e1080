"""A page that shows a filter at work: `mo.watch`."""

import errno
import html
import os
import socket
import sys
import webbrowser
from typing import Any

import jax
import numpy as np

from motes.core import checks
from motes.filters.stream import Stream
from motes.report.run import run_page
from motes.report.scene import Scene, scene_of
from motes.watch.answers import Answers
from motes.watch.guard import Guard, is_any, is_loopback
from motes.watch.recorder import Recorder, Step
from motes.watch.server import Server

HEIGHT = 760
"""Pixels of the page in a notebook."""


class Page:
    """A page at work: `show` it each step; or give it to a live run as a watcher, which calls it.

    Attributes:
        stream: the stream that is shown; None before a live run has begun.
    """

    def __init__(self, recorder: Recorder, guard: Guard, server: Server):
        """Take its parts; see `watch`."""
        self._recorder, self._guard, self._server = recorder, guard, server
        self.stream: Stream | None = None

    @property
    def address(self) -> str:
        """Link to the page, with the token that lets its bearer look."""
        return self._linked("127.0.0.1" if is_any(self._guard.host) or is_loopback(self._guard.host) else self._guard.host)

    def _linked(self, host: str) -> str:
        host = "[::1]" if self._guard.host == "::1" else f"[{host}]" if ":" in host else host
        return f"http://{host}:{self._guard.port}/?token={self._guard.token}"

    def show(self, seconds: float | None = None, time: float | None = None, picture: Any = None) -> None:
        """Show the state that the stream is in, after an `update`; takes microseconds, and never waits.

        Args:
            seconds: that the step took, for the chart of times.
            time: of the measurement, seconds; steps are only numbered where none is given.
            picture: what was seen, uint8 `(height, width, 3)`, to stand behind the cloud.

        Raises:
            MotesError: there is no stream yet, or what is given is of another form.
        """
        stream = self.stream
        if stream is None:
            checks.refuse("show", "a page of a stream, as mo.watch(stream) opens it", "one of none yet")
        if picture is not None:
            form = f"{picture.dtype} {picture.shape}" if isinstance(picture, (np.ndarray, jax.Array)) else type(picture).__name__
            if not (form.startswith("uint8 ") and picture.ndim == 3 and picture.shape[2] == 3):
                checks.refuse("show picture", "an array of uint8, (height, width, 3)", form)
        seconds, time = _number("show seconds", seconds), _number("show time", time)
        if stream.info is not None:
            self._recorder.leave(stream, Step(stream.info, seconds, time), picture)

    def __call__(self, stream: Stream, taken: Any) -> None:
        """Show what a live run tells those who watch it: the stream, and the seconds and the time of its newest step."""
        self.stream = stream
        self.show(taken.seconds, taken.time)

    def end(self, state: str = "ended", report: str | None = None) -> None:
        """Say on the page that the run has ended.

        Args:
            state: a word or a few for it.
            report: a web page of the run, to be linked to.
        """
        self._server.answers.report = report
        self._server.answers.state = state

    def report(self, title: str = "Run") -> str:
        """Return a web page of what was shown so far, in one file that needs no network."""
        return run_page(self._recorder.film(title))

    def close(self) -> None:
        """Take the page off; the filter is not touched."""
        self._server.close()

    def __repr__(self) -> str:
        """Print the link."""
        return f"Page at {self.address}"

    def _repr_html_(self) -> str:
        self._server.framed = True
        # cookies of another host would not come along: a notebook is usually at this one
        source = html.escape(self._linked("localhost"), quote=True)
        return f'<iframe src="{source}" width="100%" height="{HEIGHT}" style="border:0" title="motes"></iframe>'


def _number(argument: str, value: Any) -> float:
    """Return a number, NaN where none is given, or refuse."""
    if value is None:
        return np.nan
    if isinstance(value, (int, float)):
        return float(value)
    found = checks.as_numbers(argument, value, "a number, or None")
    if np.ndim(found):
        checks.refuse(argument, "a number, or None", f"shape {np.shape(found)}")
    return float(found)


def watch(
    stream: Stream, scene: Scene | None = None, truth: Any = None, *, budget: float | None = None, host: str = "127.0.0.1",
    port: int = 0, title: str = "",
) -> Page:  # fmt: skip
    """Open a page on this machine that shows a stream at work; call its `show` after each `update`.

    The page is for who has its link alone, shows and never acts: nothing that is asked of it changes what the filter does or waits for.

    Args:
        stream: the filter at work.
        scene: where the law is drawn; its first two states if not given.
        truth: true states `(t, x)` by step, where they are known and no scene is given.
        budget: seconds that a step may take, to be held against those that it took.
        host: address to listen at; any but the loopback lets others on the network ask for it.
        port: to listen at; a free one if 0.
        title: over the page; the kind of filter if empty.

    Raises:
        MotesError: scene or truth do not fit the stream, or host or port cannot be used.
        MissingExtraError: the packages that serve the page are not installed.
    """
    checks.instance("watch stream", stream, Stream, "what mo.stream gave")
    checks.instance("watch title", title, str, "a text")
    names = tuple(stream.model.names)
    if scene is None:
        if truth is not None:
            truth = checks.as_numbers("watch truth", truth)
            checks.shape("watch truth", truth, (None, len(names)), "(steps, states)")
        scene = scene_of(names, truth, tuple(stream.model.circular))
    elif not isinstance(scene, Scene):
        checks.refuse("watch scene", "a Scene (motes.report.scene), or None", type(scene).__name__)
    elif truth is not None:
        checks.refuse("watch truth", "none beside a scene, which has its own", type(truth).__name__)
    if budget is not None:
        checks.above_zero("watch budget", budget)
    recorder = Recorder(stream.filter, stream.model, scene, budget)
    page = opened_page(recorder, host, port, title or type(stream.filter).__name__)
    page.stream = stream
    return page


def opened_page(recorder: Recorder, host: str, port: int, title: str) -> Page:
    """Open a page that shows what a recorder has, of a stream that has perhaps not begun.

    Raises:
        MotesError: the port cannot be used.
        MissingExtraError: the packages that serve the page are not installed.
    """
    for module in ("starlette", "uvicorn", "websockets"):
        checks.need(module, "dashboard")
    listener = listening(host, port)
    guard = Guard(host, listener.getsockname()[1])
    return Page(recorder, guard, Server(listener, guard, Answers(recorder, title)))


def listening(host: str, port: int) -> socket.socket:
    """Return a socket that listens.

    Raises:
        MotesError: the port is taken, or the address is none of this machine's.
    """
    if not isinstance(host, str) or not host:  # an empty one would be all addresses, without a word
        checks.refuse("watch host", "an address of this machine", repr(host)[:80], "0.0.0.0 is all of them.")
    if isinstance(port, bool) or not isinstance(port, int) or not 0 <= port < 2**16:
        checks.refuse("watch port", "a whole number from 0 to 65535", repr(port))
    try:
        found = socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET, backlog=128)
    except (OSError, UnicodeError) as reason:
        if getattr(reason, "errno", None) == errno.EADDRINUSE:
            checks.refuse("watch port", "one that is free", f"{port}, which another program listens at", "Leave it out to take any.")
        if getattr(reason, "errno", None) == errno.EACCES:
            checks.refuse("watch port", "one that you may listen at", port, "Those from 1024 on are free to all.")
        checks.refuse("watch host", "an address of this machine", f"{host!r:.80} ({getattr(reason, 'strerror', None) or reason})")
    found.setblocking(False)
    return found


def in_browser(address: str) -> bool:
    """Open a link in the user's browser; tells whether there is one."""
    if sys.platform.startswith("linux") and not any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))):
        return False
    try:
        return webbrowser.open(address)
    except webbrowser.Error:
        return False
