"""A user's own model, measurements and filter: what `motes run`, `motes plan` and `motes study` share of them."""

import importlib
import importlib.util
import inspect
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from motes.cli.options import from_flags, from_table, read_toml, refuse, shown
from motes.cli.records import flags_of, merged

if TYPE_CHECKING:
    import numpy as np

    from motes.models.interface import Model

RECORDS = ("filter", "smoother", "filters")
"""Options that choose records: tables of a file, or flags."""


@dataclass(frozen=True)
class Data:
    """The measurements: CSV, JSON, Parquet, NetCDF, MAT or NPZ, one row or entry per step.

    Attributes:
        file: the file.
        columns: names of what was measured, in the order of the sensor's components; all but those below if none is named.
        time: name of the time stamps: the model then gets the seconds since the step before as u["dt"].
        inputs: names of the inputs, which the model gets by name, as u["speed"].
        truth: names of the true states, in the order of the states, for scoring.
    """

    file: str = field(default="", metadata={"path": True})
    columns: tuple[str, ...] = ()
    time: str = ""
    inputs: tuple[str, ...] = ()
    truth: tuple[str, ...] = ()


def is_own(words: Sequence[str]) -> bool:
    """Tell whether a command line is of a model of the user's: MODULE:FUNCTION, or a TOML file that names one."""
    if not words or words[0].startswith("-"):
        return False
    if words[0].endswith(".toml"):
        return Path(words[0]).is_file() and ":" in str(read_toml(words[0]).get("application", ""))
    return ":" in words[0]


def settings_of(kind: type, words: Sequence[str], usage: str) -> tuple[Any, dict[str, Any]]:
    """Return the settings of a command, and the choices of records beside them.

    Args:
        kind: a frozen dataclass with a field `application`.
        words: of the command line: MODULE:FUNCTION or a TOML file, then flags.
        usage: the command, for messages and help.

    Raises:
        MotesError: an option cannot be used.
    """
    choices, flags = flags_of(words[1:], RECORDS)
    # --data FILE is short for --data.file FILE
    flags = ["--data.file" if word == "--data" else word for word in flags]
    if words[0].endswith(".toml"):
        table = read_toml(words[0])
        choices = {name: merged(table.get(name), choices.get(name, {})) for name in RECORDS if name in table or name in choices}
        default = from_table(kind, {key: value for key, value in table.items() if key not in RECORDS}, words[0])
        where = str(Path(words[0]).resolve().parent)
    else:
        default, where = kind(application=words[0]), ""
    settings = from_flags(default, flags, usage)
    return settings, {**choices, "folder": where}


class Made(NamedTuple):
    """What the user's function made.

    Attributes:
        model: the model.
        given: what else it gave: `ys`, `inputs`, `truth`.
    """

    model: "Model"
    given: dict[str, Any]


def made(application: str, folder: str, data: dict[str, "np.ndarray"] | None) -> Made:
    """Call the user's function.

    Args:
        application: "module:function" or "file.py:function".
        folder: to look in first; the present one if empty.
        data: arrays of the file of measurements by name, for a function that takes them.

    Raises:
        MotesError: there is no such module or function, it fails, or does not give a model.
    """
    from motes.models.interface import Model

    function = _function(application, folder)
    try:
        takes = len(inspect.signature(function).parameters)
    except (TypeError, ValueError):
        takes = 0
    if takes > 1 or (takes == 1 and data is None):
        refuse(f"application {application}", "a function of no arguments, or of the data by name (with --data)", f"one of {takes}")
    found = _guarded(application, lambda: function(data) if takes else function())
    given = dict(found) if isinstance(found, dict) else {"model": found}
    if not isinstance(given.get("model"), Model):
        refuse(f"application {application}", "a function that returns a model, or a dictionary with 'model'", type(found).__name__)
    unknown = set(given) - {"model", "ys", "inputs", "truth"}
    if unknown:
        refuse(f"application {application}", "a dictionary of model, ys, inputs, truth", shown(sorted(unknown)[0]))
    return Made(given.pop("model"), given)


def _function(application: str, folder: str) -> Callable[..., Any]:
    place, _, name = application.rpartition(":")
    if not place or not name.isidentifier():
        refuse("application", "MODULE:FUNCTION or FILE.py:FUNCTION", shown(application))
    if place.endswith(".py"):
        path = Path(folder) / place
        if not path.is_file():
            refuse(f"application {application}", "a Python file", f"no file {str(path)!r:.160}")
        spec = importlib.util.spec_from_file_location(path.stem, path)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules.setdefault(path.stem, module)
        _guarded(application, lambda: spec.loader.exec_module(module))  # type: ignore[union-attr]
    else:
        sys.path.insert(0, folder or ".")
        module = _guarded(application, lambda: importlib.import_module(place))
    function = getattr(module, name, None)
    if not callable(function):
        there = ", ".join(sorted(key for key, value in vars(module).items() if inspect.isfunction(value))[:8]) or "none"
        refuse(f"application {application}", f"a function {name}", f"none of that name (functions there: {there})")
    return function


def _guarded(application: str, work: Callable[[], Any]) -> Any:
    """Do what is the user's own, and turn what fails in it into one line with its file and line."""
    from motes.core.checks import MotesError

    try:
        return work()
    except MotesError:
        raise
    except Exception as reason:
        trace = [frame for frame in traceback.extract_tb(reason.__traceback__) if "motes/cli" not in frame.filename.replace("\\", "/")
                 and "importlib" not in frame.filename]  # fmt: skip
        where = f" at {trace[-1].filename[-100:]}, line {trace[-1].lineno}" if trace else ""
        text = " ".join(str(reason).split())[:200]
        refuse(f"application {application}", "a module and function that work", f"{type(reason).__name__}{where}: {text}")


class Measured(NamedTuple):
    """Measurements as `run` takes them.

    Attributes:
        ys: measurements, or a timeline of them.
        inputs: by name, or None.
        truth: true states `(t, x)`, or None.
    """

    ys: Any
    inputs: Any
    truth: Any


def read(data: Data) -> dict[str, "np.ndarray"]:
    """Read all arrays of a file of measurements, by name.

    Raises:
        FileError: the file cannot be read.
    """
    from motes.io.arrays import read_arrays

    return read_arrays(data.file)


def measured(data: Data, arrays: dict[str, "np.ndarray"], model: "Model") -> Measured:
    """Return measurements, inputs and truth of the arrays of a file.

    Raises:
        MotesError: a name is not there, or there are not as many true states as states.
    """
    import numpy as np

    from motes.models.times import times

    def column(name: str) -> np.ndarray:
        if name not in arrays:
            refuse("data", f"names in the file: {', '.join(arrays)[:200]}", shown(name))
        return arrays[name]

    taken = {data.time, *data.inputs, *data.truth}
    names = data.columns or tuple(name for name in arrays if name not in taken)
    if not names:
        refuse("data columns", "at least one measurement in the file", "none beside time, inputs and truth")
    parts = [column(name) for name in names]
    ys = parts[0] if len(parts) == 1 and parts[0].ndim > 1 else np.stack(parts, axis=1) if all(part.ndim == 1 for part in parts) else \
        dict(zip(names, parts, strict=True))  # fmt: skip
    inputs = {name: column(name) for name in data.inputs} or None
    truth = np.stack([column(name) for name in data.truth], axis=1) if data.truth else None
    if truth is not None and truth.shape[1] != model.size:
        refuse("data truth", f"a column for each of the states {', '.join(model.names)}", ", ".join(data.truth))
    return Measured(times(column(data.time), ys, inputs=inputs) if data.time else ys, None if data.time else inputs, truth)
