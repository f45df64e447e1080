"""What a command is asked for: an application, its settings, and filters by name, from a TOML file and from flags.

The first word is the name of an application, `MODULE:FUNCTION` or `FILE.py:FUNCTION` of the user's own, or a TOML file that has one of
these as `application`. A file holds the settings of the application, `seed`, `n` and `out`, the filters, and what `motes plan` and
`motes study` alone are asked as tables of these names, so that one file serves all commands.
"""

import dataclasses
import importlib
import pkgutil
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from motes.cli.dictionaries import with_dictionaries, without_dictionaries
from motes.cli.options import first_and_flags, from_flags, from_table, read_toml, refuse, shown
from motes.cli.records import build, file_name, flags_of, merged, with_size
from motes.core.spelling import perhaps
from motes.live.settings import Live

if TYPE_CHECKING:
    from motes.applications.interface import Job
    from motes.filters.interface import Filter

RECORDS = ("filter", "filters", "smoother")
"""Options that choose records: tables of a file, or flags."""
FIRST = "the name of an application, MODULE:FUNCTION of your own, or a TOML file first"


@dataclass(frozen=True)
class Run:
    """Run filters on an application or on your own model: NAME, MODULE:FUNCTION, FILE.py:FUNCTION or a TOML file comes first.

    `--filter NAME` chooses a filter, `--filter.n 2000` and so on its parameters, by the names that it has in Python; several are chosen by
    names of your own, `--filters.few particle --filters.few.n 100`; `--smoother NAME` smooths what they found.

    Attributes:
        seed: of the filters, and of a world that is made up.
        n: number of particles of all filters that have particles; their own if not given.
        elements: elements that the particles of each filter are shared out over, as of `mo.Distributed`; 8 with several processes.
        processes: processes of this machine that share the work.
        hosts: work with the processes that a launcher started (srun, mpirun, torchrun, Kubernetes).
        out: folder for the results.
        live: measurements as they come (`--live`, `--source udp://127.0.0.1:5005` and `--budget 5ms` are short for keys of it).
    """

    seed: int = 0
    n: int | None = None
    elements: int | None = None
    processes: int = 1
    hosts: bool = False
    out: str = field(default="out", metadata={"path": True})
    live: Live = Live()


@dataclass(frozen=True)
class Watch:
    """Look at a filter while it works: NAME, MODULE:FUNCTION, FILE.py:FUNCTION or a TOML file comes first; the first filter is shown.

    Attributes:
        rate: steps a second at most; 0 for as fast as the filter can.
        budget: time that a step may take with its unit, such as 5ms, to be held against what it takes.
        live: measurements as they come, as of motes run (`--live` and `--source udp://127.0.0.1:5005` are short for keys of it).
        port: at which the page listens; a free one if 0.
        host: address at which it listens; any but the loopback lets others on the network ask for it.
        browser: open the page in the browser.
        stay: seconds for which the page stays after the last step; until Ctrl-C if not given.
        seed: of the filter, and of a world that is made up.
        n: number of particles; the filter's own if not given.
        out: folder for the report.
    """

    rate: float = 25.0
    budget: str = ""
    live: Live = Live()
    port: int = 0
    host: str = "127.0.0.1"
    browser: bool = True
    stay: float | None = None
    seed: int = 0
    n: int | None = None
    out: str = field(default="out", metadata={"path": True})


@dataclass(frozen=True)
class Plan:
    """Find the most accurate filter for a time per step: NAME, MODULE:FUNCTION, FILE.py:FUNCTION or a TOML file comes first.

    Attributes:
        budget: time per step with its unit, such as 5ms, 200us or 0.1s.
        states: states that count, of one unit; those of the application if none is named, or all.
        steps: of each pilot run.
        runs: most pilot runs for one candidate.
        verify: measure the choice once more.
        seed: of the pilot runs, and of a world that is made up.
    """

    budget: str = ""
    states: tuple[str, ...] = ()
    steps: int = 100
    runs: int = 32
    verify: bool = False
    seed: int = 0


@dataclass(frozen=True)
class Study:
    """Compare filters on many simulated runs: NAME, MODULE:FUNCTION, FILE.py:FUNCTION or a TOML file comes first.

    `--filters.a particle --filters.a.n 500` names a filter "a" and chooses it with its parameters. A study that was stopped goes on where
    it was; more runs or filters can be added.

    Attributes:
        steps: of each run; as many as the application has if not given, or 100.
        runs: how many.
        seed: of all runs, and of a world that is made up.
        n: number of particles of all filters that have particles; their own if not given.
        scheduler: address of a Dask scheduler whose workers do the runs, such as tcp://host:8786; this process if not given. They read the
            same files, under the same names.
        out: folder in which runs and results are kept.
    """

    steps: int | None = None
    runs: int = 100
    seed: int = 0
    n: int | None = None
    scheduler: str = ""
    out: str = field(default="out", metadata={"path": True})


NAME = r"\w[\w +-]{0,59}"
"""What filters may be called: files are named after them."""
TABLES = {"plan": Plan, "study": Study, "watch": Watch}
"""Tables of a file that one command alone reads."""


class Application(NamedTuple):
    """Where a job comes from.

    Attributes:
        name: of the application, as the user gave it.
        settings: frozen dataclass of what can be set of it.
        load: gives the job from the settings and a seed.
    """

    name: str
    settings: type
    load: "Callable[[Any, int], Job]"


def applications() -> list[str]:
    """Return the names of all applications: the folders in `motes.applications`."""
    room = importlib.import_module("motes.applications")
    return sorted(module.name for module in pkgutil.iter_modules(room.__path__) if module.ispkg)


def application(word: str, folder: str) -> Application:
    """Find an application.

    Args:
        word: its name, or MODULE:FUNCTION or FILE.py:FUNCTION of the user's own.
        folder: to look in first for what is the user's own; the present one if empty.

    Raises:
        MotesError: there is none.
    """
    if ":" in word:
        from motes.cli import own

        return Application(word, own.Own, lambda settings, seed: own.load(word, folder, settings))
    if word not in applications():
        hint = perhaps(word, applications()) or ("Is it a TOML file? Its name must end in .toml." if Path(word).is_file() else "")
        refuse("application", f"one of {', '.join(applications())}, or MODULE:FUNCTION of your own", shown(word), hint)
    room = f"motes.applications.{word}"
    return Application(word, importlib.import_module(f"{room}.settings").Settings,
                       lambda settings, seed: importlib.import_module(f"{room}.job").load(settings, seed))  # fmt: skip


class Asked(NamedTuple):
    """What a command is asked for.

    Attributes:
        application: where the job comes from.
        settings: what was set, of the command and of the application, in one record.
        choices: tables of filters and smoother, by "filter", "filters" and "smoother".
    """

    application: Application
    settings: Any
    choices: dict[str, Any]

    def own(self) -> Any:
        """Return the settings of the application alone."""
        kind = self.application.settings
        return kind(**{field.name: getattr(self.settings, field.name) for field in dataclasses.fields(kind)})

    def job(self) -> "Job":
        """Load the job.

        Raises:
            MotesError: what the application raises.
        """
        return self.application.load(self.own(), self.settings.seed)

    def chosen(self, *roots: str) -> "dict[str, Filter]":
        """Return the filters that the user names, by name.

        Args:
            roots: "filter" and "filters", or the other way round: the one that counts where both are there comes first.

        Raises:
            MotesError: a filter cannot be used.
        """
        from motes.filters.interface import Filter

        root = next((one for one in roots if one in self.choices), None)
        if root == "filter":
            filter = build(Filter, self.choices[root], root, self.settings.n)
            return {file_name(self.choices[root]): filter}
        if root is None:
            return {}
        table = self.choices[root]
        if not isinstance(table, dict) or not table or "kind" in table:
            refuse(root, "filters by names of your own", shown(table), "Give --filters.few particle --filters.few.n 100.")
        for name in table:
            if not re.fullmatch(NAME, name):
                refuse(f"{root} {shown(name)}", "a name for files: at most 60 letters, digits, spaces, _, + or -, a letter or digit first",
                       shown(name))  # fmt: skip
        return {name: build(Filter, _with_kind(choice, name), f"filters.{name}", self.settings.n) for name, choice in table.items()}

    def filters(self, job: "Job", *roots: str) -> "dict[str, Filter]":
        """Return the filters to run: those that the user names, or those of the job; with as many particles as the user wants.

        Raises:
            MotesError: there is none, or none has particles although their number is given.
        """
        found = self.chosen(*roots) or dict(job.filters)
        if not found:
            refuse("filter", "a filter by name", "none", "Give --filter particle --filter.n 1000, or a table [filter].")
        return found if self.settings.n is None else with_size(found, self.settings.n)


def _with_kind(choice: Any, name: str) -> Any:
    """Return a choice of a filter: one without a kind is of the kind that its name says."""
    return {"kind": name, **choice} if isinstance(choice, dict) else choice


def asked(options: type, words: Sequence[str], usage: str) -> Asked:
    """Read what a command is asked for.

    Args:
        options: `Run`, `Plan`, `Study` or `Watch`.
        words: of the command line, after the command.
        usage: the command, for messages and help.

    Raises:
        MotesError: no application is named, or an option cannot be used.
    """
    first, flags = first_and_flags(options(), words, usage, FIRST, "motes demo writes an example: out/terrain.toml.")
    table, folder = {}, ""
    if first.endswith(".toml"):
        table, folder = read_toml(first), str(Path(first).resolve().parent)
    name = table.pop("application", None) if first.endswith(".toml") else first
    if not isinstance(name, str):
        hint = f"application = one of {', '.join(map(repr, applications()))}, or 'model.py:make'"
        refuse(f"{Path(first).name}: application", "the name of an application in quotes", "none" if name is None else shown(name), hint)
    source = application(name, folder)
    taken = _fields(source.settings) & set().union(*map(_fields, (Run, Plan, Study, Watch)))
    if taken:
        refuse(f"application {source.name}", "settings by other names than those of the commands", sorted(taken)[0])
    kind = dataclasses.make_dataclass(options.__name__, [], bases=(options, source.settings), frozen=True)
    kind.__doc__ = options.__doc__
    chosen, flags = flags_of(flags, RECORDS)
    given = {root: merged(table[root], {}) for root in RECORDS if root in table}
    from_file = _of_file(kind, options, source, table, first)
    dictionaries, flags = without_dictionaries(from_file, _short(flags, kind))
    settings = with_dictionaries(from_flags(from_file, flags, usage), dictionaries)
    # what flags choose counts alone: a filter in place of the file's filters, and the other way round
    for root in chosen.keys() & {"filter", "filters"}:
        given.pop({"filter": "filters", "filters": "filter"}[root], None)
    return Asked(source, settings, given | {root: merged(given.get(root), choice) for root, choice in chosen.items()})


def _of_file(kind: Any, options: type, source: Application, table: dict[str, Any], path: str) -> Any:
    """Return the settings that a file gives, with those in the table of the command that reads it."""
    # every command may have a seed, a number of particles and a folder in its file, though not every one uses them
    whole = dataclasses.make_dataclass("File", [], bases=(Run, source.settings), frozen=True)
    known = ["application", *(one.name for one in dataclasses.fields(whole)), *RECORDS, *TABLES]
    for key in table:
        if key not in known:
            refuse(Path(path).name, f"the keys {', '.join(known)}", shown(key), perhaps(key, known))
    found = from_table(whole, {key: value for key, value in table.items() if key not in (*RECORDS, *TABLES)}, path)
    values = {one.name: getattr(found, one.name) for one in dataclasses.fields(whole)}
    for name, command in TABLES.items():
        if name in table:
            of_command = from_table(command, table[name], path, name)
            if command is options:
                values |= {key: getattr(of_command, key) for key in table[name]}
    return kind(**{key: value for key, value in values.items() if key in _fields(kind)})


def _fields(kind: type) -> set[str]:
    return {one.name for one in dataclasses.fields(kind)}


SHORT = {"--data": ("data", "--data.file"), "--live": ("live", "--live.on"), "--source": ("live", "--live.source"),
         "--budget": ("live", "--live.budget")}  # fmt: skip
"""Flags that are short for those of a table, where there is one of this name."""


def _short(flags: Sequence[str], settings: type) -> list[str]:
    """Return flags with those that are short written out: `--data FILE` is `--data.file FILE` where the data are a table."""
    tables = {one.name for one in dataclasses.fields(settings) if dataclasses.is_dataclass(one.default)}
    own = _fields(settings) - tables
    known = {short: flag for short, (table, flag) in SHORT.items() if table in tables and short[2:] not in own}
    return [known.get(flag, flag) + equals + value for flag, equals, value in (word.partition("=") for word in flags)]
