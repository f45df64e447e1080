"""A model of the user's own: its function, and measurements from a file."""

import importlib
import importlib.util
import inspect
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from motes.cli.options import refuse, shown
from motes.core.spelling import perhaps
from motes.io.dialect import Dialect

if TYPE_CHECKING:
    from motes.io.columns import Columns


@dataclass(frozen=True)
class Data(Dialect):
    """The measurements: CSV, JSON, Parquet, NetCDF, MAT or NPZ, one row or entry per step; or a bag (rosbag 1 or 2).

    What has a unit under units comes in meters, m/s, radians, seconds or the like.

    Attributes:
        file: the file, or the folder of a bag.
        topics: what to read of a bag, by names of your own: a topic, and after it paths of fields where those that are usual of its type
            are not wanted, as in speed = "/odom twist.twist.linear.x". Its messages have times of their own.
        columns: names of what was measured, in the order of the sensor's components; all but those below if none is named.
        time: name of the time stamps: the model then gets the seconds since the step before as u["dt"].
        inputs: names of the inputs, which the model gets by name, as u["speed"]; of a bag the last message counts.
        truth: names of the true states, in the order of the states, for scoring.
    """

    file: str = field(default="", metadata={"path": True})
    topics: dict[str, str] = field(default_factory=dict)
    columns: tuple[str, ...] = field(default=(), metadata={"column": True})
    time: str = field(default="", metadata={"column": True})
    inputs: tuple[str, ...] = field(default=(), metadata={"column": True})
    truth: tuple[str, ...] = field(default=(), metadata={"column": True})


@dataclass(frozen=True)
class Own:
    """What can be set of a model of the user's own.

    Attributes:
        data: the measurements (`--data FILE` is short for `--data.file FILE`).
    """

    data: Data = Data()


def load(application: str, folder: str, settings: Own) -> Any:
    """Make a job of the user's function and data.

    Args:
        application: "module:function" or "file.py:function".
        folder: to look in first; the present one if empty.
        settings: where the measurements are.

    Returns:
        A `Job`.

    Raises:
        MotesError: there is no such module or function, it fails, or does not give a model; or the data cannot be used.
    """
    from motes.applications.interface import Job
    from motes.io.clocks import Clock
    from motes.io.columns import Columns
    from motes.models.interface import Model
    from motes.models.times import Timeline

    function = _function(application, folder)
    asked, data = _read(settings.data)
    found = _called(application, function, data)
    if isinstance(found, Job):
        return found
    given = dict(found) if isinstance(found, dict) else {"model": found}
    if not isinstance(given.get("model"), Model):
        refuse(f"application {application}", "a function that returns a model, a dictionary with 'model', or a Job", type(found).__name__)
    unknown = set(given) - {"model", "ys", "inputs", "truth"}
    if unknown:
        refuse(f"application {application}", "a dictionary of model, ys, inputs, truth", shown(sorted(unknown)[0]))
    if data is not None and "ys" not in given:
        given = measured(asked, data, given["model"]) | given
    line = given.get("ys")
    if isinstance(line, Timeline):
        given |= {"ys": line.ys, "inputs": line.inputs, "times": line.seconds, "start": line.start}
    if isinstance(data, Columns):
        given |= {"clock": data.clocks.get(asked.time, Clock())}
    return Job(**given)


def _read(data: Data) -> "tuple[Data, dict[str, np.ndarray] | Columns | None]":
    """Return the arrays of the file that is named, if one is, and what is asked for of them."""
    from motes.cli.own_bags import TIME, on_one_line
    from motes.io.arrays import read_arrays
    from motes.io.bags import is_bag

    if not data.file:
        return data, None
    if is_bag(data.file):
        if data.time:
            refuse("data time", "none beside a bag, whose messages have times of their own", shown(data.time))
        columns, arrays = on_one_line(data.file, data.topics, data.columns, data.inputs, data.truth)
        return replace(data, columns=columns, time=TIME), arrays
    if data.topics:
        refuse("data topics", "a bag as the file (rosbag 1 or 2)", shown(data.file), "Columns are named with columns, inputs and truth.")
    # what is measured can be left unsaid; then all columns are read
    names = (*data.columns, *filter(None, (data.time,)), *data.inputs, *data.truth) if data.columns else None
    return data, read_arrays(data.file, names, data, data.time)


def _called(application: str, function: Callable[..., Any], data: dict[str, np.ndarray] | None) -> Any:
    """Return what the user's function gives; one with an argument gets the arrays of the file by name."""
    try:
        takes = len(inspect.signature(function).parameters)
    except (TypeError, ValueError):
        takes = 0
    if takes > 1 or (takes == 1 and data is None):
        refuse(f"application {application}", "a function of no arguments, or of the data by name (with --data)", f"one of {takes}")
    return _guarded(application, lambda: function(data) if takes else function())


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
        sys.path.insert(0, str(path.resolve().parent))  # as where it is run as a program
        module = importlib.util.module_from_spec(spec)
        sys.modules.setdefault(path.stem, module)
        _guarded(application, lambda: spec.loader.exec_module(module))  # type: ignore[union-attr]
    else:
        sys.path.insert(0, folder or ".")
        module = _guarded(application, lambda: importlib.import_module(place))
    function = getattr(module, name, None)
    if function is not None and not callable(function):
        refuse(f"application {application}", f"a function {name}", f"{type(function).__name__} {shown(function)}")
    if function is None:
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
        hint = ""
        if isinstance(reason, ModuleNotFoundError) and reason.name == application.partition(":")[0].partition(".")[0]:
            hint = f"Modules are looked for in {sys.path[0] or '.'}, too; a file is named FILE.py:FUNCTION."
        refuse(f"application {application}", "a module and function that work", f"{type(reason).__name__}{where}: {text}", hint)


def measured(data: Data, arrays: dict[str, np.ndarray], model: Any) -> dict[str, Any]:
    """Return measurements, inputs and truth of the arrays of a file, by these names.

    Raises:
        MotesError: a name is not there, or there are not as many true states as states.
    """
    from motes.models.times import times

    def column(name: str) -> np.ndarray:
        if name not in arrays:
            refuse("data", f"names in the file: {', '.join(arrays)[:200]}", shown(name), perhaps(name, arrays))
        # MATLAB has no vectors but rows and columns
        return arrays[name].reshape(-1) if arrays[name].ndim == 2 and 1 in arrays[name].shape else arrays[name]

    taken = {data.time, *data.inputs, *data.truth}
    names = data.columns or tuple(name for name in arrays if name not in taken)
    if not names:
        refuse("data columns", "at least one measurement in the file", "none beside time, inputs and truth")
    parts = [column(name) for name in names]
    sensors = {name for mode in model.each_mode() for name, _ in mode.sensor.sensors}
    by_name = sensors.issuperset(names) or (len(parts) > 1 and any(part.ndim > 1 for part in parts))
    ys: Any = dict(zip(names, parts, strict=True)) if by_name else parts[0] if parts[0].ndim > 1 else np.stack(parts, axis=1)
    inputs = {name: column(name) for name in data.inputs} or None
    truth = np.column_stack([column(name) for name in data.truth]) if data.truth else None
    if truth is not None and truth.shape[1] != model.size:
        refuse("data truth", f"a column for each of the states {', '.join(model.names)}", ", ".join(data.truth))
    if data.time:
        return {"ys": times(column(data.time), ys, inputs=inputs), "truth": truth}
    return {"ys": ys, "inputs": inputs, "truth": truth}
