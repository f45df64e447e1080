"""`motes demo [NAME]`: run an application on a world of its own, and write that as a user's own files would come; or watch it (`--watch`).

Beside what `motes run` writes there are the files of the world and NAME.toml, which names them: to be changed and run again.
"""

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from motes.cli import processes
from motes.cli.asked import Asked, Run, applications, asked
from motes.cli.options import refuse
from motes.cli.records import choice_of, is_spelled
from motes.cli.run import carried_out, trusted
from motes.core.spelling import perhaps

if TYPE_CHECKING:
    from motes.applications.interface import Job

FIRST = "terrain"
"""The application that is shown where none is named."""


def main(words: Sequence[str]) -> None:
    """Run an application.

    Raises:
        MotesError: there is none of that name, or it refuses its options.
    """
    name, rest = (words[0], words[1:]) if words and not words[0].startswith("-") else (FIRST, words)
    name = demonstrations().get(name, name)
    if name not in applications():
        there = [*applications(), *demonstrations()]
        refuse("demo", "one of " + ", ".join(there), repr(name), perhaps(name, there))
    if "--watch" in rest:
        from motes.cli.watch import shown_demo

        shown_demo(name, [word for word in rest if word != "--watch"], write)
        return
    from motes.core.hosts import is_first

    wish = asked(Run, [name, *rest], f"motes demo {name}")
    if wish.settings.live.is_asked_for:
        refuse("live", f"motes run {name} --live", f"motes demo {name}")
    if processes.started("demo", [name, *rest], wish.settings):
        return
    with processes.at_work(wish.settings):
        done = carried_out(wish)
        path = done.folder / f"{name}.toml"
        if is_first():
            write(path, wish, done.job)
        print(f"Results are in {done.folder}. The same from its files: motes run {path}")
        trusted(done)


def demonstrations() -> dict[str, str]:
    """Return the applications whose demonstration has a name of its own, by that name: `DEMO` in their settings."""
    found = ((importlib.import_module(f"motes.applications.{name}.settings"), name) for name in applications())
    return {settings.DEMO: name for settings, name in found if "DEMO" in vars(settings)}


def write(path: Path, wish: Asked, job: "Job") -> None:
    """Write the files of the world, and beside them the TOML file that has all that was asked and names them."""
    from motes.cli import toml
    from motes.cli.running import write_text

    head = [
        f"# Run with: motes run {path.name}     Any key can be changed by a flag, too, such as --n 2000 (see motes run --help).",
        "# motes plan and motes study read the same file. Paths are relative to this file.",
        f'application = "{wish.application.name}"',
        f"seed = {wish.settings.seed}",
        'out = "run"',
        "",
    ]
    text = toml.written(job.written(path.parent, wish.own()), path.parent)
    choices = {name: choice_of(filter) for name, filter in wish.filters(job, "filter", "filters").items()}
    if not all(map(is_spelled, choices.values())):
        # those of the application have functions of its own: it brings them along again
        size = [] if wish.settings.n is None else [f"n = {wish.settings.n}", ""]
        write_text(path, "\n".join([*head[:-1], *size, "", text]))
        return
    tables = [toml.table(f"filters.{name}", choice) for name, choice in choices.items()]
    about = "# the filters that are compared, each a table: kind is their name in Python, the other keys are their parameters"
    write_text(path, "\n".join([*head, text, about, *tables]))
