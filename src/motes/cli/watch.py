"""`motes watch APPLICATION`: run a filter step by step, and show it on a page of this machine while it works.

The page stays when the last step is done, with a link to the report, which is written to the folder `--out`, too.
"""

import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from motes.cli.asked import Asked, Watch, asked
from motes.cli.options import check_seed, refuse, seconds

if TYPE_CHECKING:
    from motes.applications.interface import Job
    from motes.filters.interface import Filter
    from motes.report.scene import Scene
    from motes.watch.page import Page

USAGE = "motes watch APPLICATION"
PATIENCE = 10.0
"""Seconds without a measurement after which that is said."""
MOST_RATE = 1e6


def main(words: Sequence[str]) -> None:
    """Show what is asked for.

    Raises:
        MotesError: an option, a file or the user's function cannot be used.
    """
    watched(asked(Watch, words, USAGE))


def watched(wish: Asked, written: Any = None) -> None:
    """Run the first filter, show it, and write its report.

    Args:
        wish: what is asked for.
        written: called with the job and the folder once the report is there; or None.

    Raises:
        MotesError: the application refuses, the filter does not fit, or the port is taken.
    """
    settings = wish.settings
    check_seed(settings.seed)
    if not 0 <= settings.rate <= MOST_RATE:
        refuse("rate", "steps a second, at least 0", settings.rate)
    if settings.stay is not None and not 0 <= settings.stay < threading.TIMEOUT_MAX:
        refuse("stay", "seconds, at least 0", settings.stay)
    said = settings.budget or (settings.live.budget if settings.live.is_asked_for else "")
    budget = seconds(said) if said else None
    from motes.cli import running
    from motes.watch.page import listening

    # a port that is taken is told before a world is made up
    listening(settings.host, settings.port).close()
    running.check_folder(settings.out)
    wish.chosen("filter", "filters")
    job = wish.job()
    if settings.live.is_asked_for:
        _watched_live(wish, job, budget)
        return
    if job.ys is None:
        refuse("data", "a file of measurements", "none", "Give --data FILE, or return 'ys' from the function.")
    name, filter = next(iter(wish.filters(job, "filter", "filters").items()))
    if job.about():
        print(job.about())
    page = _page(job, job.scene(), filter, wish, budget)
    _worked_through(job, filter, settings, page)
    folder = _reported(wish, name, page)
    if written is not None:
        written(folder, job)
    _stay(settings.stay)
    page.close()


def _watched_live(wish: Asked, job: "Job", budget: float | None) -> None:
    """Show a filter on measurements as they come, until their source ends or it is asked to; standard output is the page's."""
    from motes.cli import live

    name, filter = live.one_filter(wish, job)
    scene = job.scene()
    if wish.settings.live.source:
        # what is true of the application's own measurements is not true of these
        scene = replace(scene, truth=None)

    def done() -> None:
        if page.stream is not None:
            _reported(wish, name, page)

    with live.logged():
        run, path = live.prepared(wish, job, name, filter, [sink for sink in wish.settings.live.sinks if sink != "-"])
        page = _page(job, scene, filter, wish, budget)
        run.watchers.append(page)
        live.carried_on(run, path, done)
    _stay(wish.settings.stay)
    page.close()


def _reported(wish: Asked, name: str, page: "Page") -> Path:
    """Write the report of what was shown, link it on the page, and return its folder."""
    from motes.cli import running

    folder = running.made_folder(wish.settings.out)
    report = page.report(f"{wish.application.name}: {name}")
    running.write_text(folder / "report.html", report)
    page.end("ended", report)
    print(f"The report is in {folder / 'report.html'}.")
    return folder


def _page(job: "Job", scene: "Scene", filter: "Filter", wish: Asked, budget: float | None) -> "Page":
    """Open the page, which waits for the first step, and tell where it is."""
    from motes.watch.page import in_browser, opened_page
    from motes.watch.recorder import Recorder

    settings = wish.settings
    page = opened_page(Recorder(job.worn(filter), job.model, scene, budget), settings.host, settings.port, wish.application.name)
    print(f"Watch it at {page.address}", flush=True)
    if settings.browser and not in_browser(page.address):
        print("motes watch: no browser was found here; open the link in one.", file=sys.stderr)
    return page


def _worked_through(job: "Job", filter: "Filter", settings: Any, page: "Page") -> None:
    """Run a filter over what comes in, at the rate that is asked for, and show each step."""
    least = 1 / settings.rate if settings.rate else 0
    due = time.perf_counter()
    with _heard(PATIENCE) as heard:
        for moment in job.moments():
            heard()
            if page.stream is None:
                page.stream = job.streamed(settings.seed, filter, moment.u)
            else:
                page.stream.predict(moment.u)
            began = time.perf_counter()
            page.stream.update(moment.y)
            page.show(time.perf_counter() - began, moment.time, moment.picture)
            # who comes late makes up for it within a second, and not by haste
            due = max(due + least, time.perf_counter() - 1)
            time.sleep(max(0.0, due - time.perf_counter()))
    if page.stream is None:
        refuse("data", "at least one measurement", "none")


@contextmanager
def _heard(patience: float) -> Iterator[Any]:
    """Say once, each time that nothing comes for so long, that nothing comes; gives what is called when something did."""
    came, ended = threading.Event(), threading.Event()

    def listen() -> None:
        told = False
        while not ended.is_set():
            if came.wait(patience):
                told = False
                came.clear()
            elif not told and not ended.is_set():
                told = True
                print(f"motes watch: expected a measurement, got none for {patience:g} s. It is waited for; Ctrl-C ends it.",
                      file=sys.stderr, flush=True)  # fmt: skip

    threading.Thread(target=listen, daemon=True).start()
    try:
        yield came.set
    finally:
        ended.set()
        came.set()


def _stay(limit: float | None) -> None:
    if limit is None:
        print("The page stays until Ctrl-C.", flush=True)
    threading.Event().wait(limit)


def shown_demo(name: str, words: Sequence[str], write: Any) -> None:
    """Show an application on a world of its own, and write that as a user's own files would come.

    Args:
        name: of the application.
        words: its options.
        write: writes the files into a folder, of path, wish and job.
    """
    wish = asked(Watch, [name, *words], f"motes demo {name} --watch")
    if wish.settings.live.is_asked_for:
        refuse("live", f"motes watch {name} --live", f"motes demo {name} --watch")

    def written(folder: Path, job: "Job") -> None:
        path = folder / f"{name}.toml"
        write(path, wish, job)
        print(f"The same from its files: motes watch {path}")

    watched(wish, written)
