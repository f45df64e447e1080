"""Tables and series of pandas, polars and xarray: numbers, names of columns and times of rows taken apart.

None of these libraries is imported: an object says by its class which one it is from, and is asked by its own methods.
"""

from typing import Any

import numpy as np

from motes.core import checks
from motes.core.record import replace
from motes.io.calendars import calendar
from motes.io.labels import Labelled, Labels, agree, labels_of


def unlabelled(argument: str, value: Any) -> tuple[Any, Labels | None]:
    """Take labels off data.

    Args:
        argument: what it is called in messages.
        value: a Series or DataFrame of pandas or polars, a DataArray or Dataset of xarray, or a dictionary of such, of which a series
            becomes one column, `(t, 1)`; anything else comes back as it is.

    Returns:
        Arrays of numbers with the time axis first, in which NaN stands for what is missing, and the labels; None where there were none.

    Raises:
        MotesError: a column holds no numbers, the index has several levels, or its times are missing or decrease.
    """
    if isinstance(value, Labelled):
        return value.values, value.labels
    kind = _kind(value)
    if kind is not None:
        return _READERS[kind](argument, value)
    if type(value) is dict and value:
        parts = {name: unlabelled(f"{argument}[{name!r}]", part) for name, part in value.items()}
        return {name: part for name, (part, _) in parts.items()}, common(argument, [labels for _, labels in parts.values()])
    return value, None


def is_labelled(value: Any) -> bool:
    """Tell whether `unlabelled` takes something off: a table or series of another library, or a dictionary with such in it."""
    if type(value) is dict:
        return any(map(is_labelled, value.values()))
    return isinstance(value, Labelled) or _kind(value) is not None


def common(argument: str, each: list[Labels | None]) -> Labels | None:
    """Return the index that several tables share, without names of columns; None where none has one.

    Raises:
        MotesError: they have different ones.
    """
    known = [labels for labels in each if labels is not None and labels.index is not None]
    for other in known[1:]:
        agree(argument, "the times of one another", known[0], other, "Bring them together: mo.times(radar=..., camera=...).")
    return replace(known[0], columns=()) if known else None


def filled(ys: Any) -> Labelled:
    """Return measurements with a row of NaN for each time that is missing from their regular index.

    Models take one step from row to row: with the rows that were left out in their places a step always takes as long. Steps are even, or
    go by months, by their last days, by their first or last weekdays, or from Monday to Friday.

    Example:
        >>> days = np.array(["2024-01-01", "2024-01-02", "2024-01-04", "2024-01-05"], "datetime64[D]")
        >>> mo.io.filled(pandas.Series([1.0, 2.0, 4.0, 5.0], days)).values.shape
        (5, 1)

    Args:
        ys: Series or DataFrame of pandas or polars, DataArray or Dataset of xarray.

    Raises:
        MotesError: it has no index, or one that is not regular.
    """
    values, labels = unlabelled("filled ys", ys)
    if labels is None or labels.index is None or isinstance(values, dict):
        checks.refuse("filled ys", "a table or series with an index of dates or numbers", type(ys).__name__)
    found = calendar(labels.index, labels.zone)
    if found is None:
        hint = "Give the time between steps to the model: mo.times(stamps, ys)."
        checks.refuse("filled ys", "an index with equal steps, some of them missing", "one that has none", hint)
    axis, places = found
    values = np.asarray(values, np.result_type(values, np.float32))
    whole = np.full((int(places[-1]) + 1, *values.shape[1:]), np.nan, values.dtype)
    whole[places] = values
    return Labelled(whole, replace(labels, index=axis.at(np.arange(len(whole)), labels.index.dtype)))


def _with_columns(labels: Labels | None, columns: tuple[str, ...]) -> Labels | None:
    return (None if not columns else Labels(columns=columns)) if labels is None else replace(labels, columns=columns)


def _pandas(argument: str, value: Any) -> tuple[Any, Labels | None]:
    frame = value if value.ndim == 2 else value.to_frame()
    index, dates = frame.index, [place for place, kind in enumerate(frame.dtypes) if getattr(kind, "kind", "O") == "M"]
    in_order = len(dates) == 1 and frame.iloc[:, dates[0]].is_monotonic_increasing and frame.iloc[:, dates[0]].is_unique
    plain = type(index).__name__ == "RangeIndex" and index.start == 0 and index.step == 1
    if plain and in_order and frame.shape[1] > 1:
        # pandas' own index of dates, without pandas being imported here
        index = frame.iloc[:, dates].set_index(frame.columns[dates[0]]).index
        frame, plain = frame.iloc[:, [place for place in range(frame.shape[1]) if place != dates[0]]], False
    if index.nlevels > 1:
        checks.refuse(f"{argument} index", "one level", f"{index.nlevels} of them ({', '.join(map(str, index.names))})",
                      "Take one series of the table, or .unstack() it.")  # fmt: skip
    labels = None if plain else _of_pandas_index(argument, index)
    names = [" ".join(map(str, name)) if isinstance(name, tuple) else str(name) for name in frame.columns]
    unnamed = type(frame.columns).__name__ == "RangeIndex" or (value.ndim == 1 and value.name is None)
    return checks.as_numbers(argument, frame, "real numbers, shape (t, y)"), _with_columns(labels, () if unnamed else tuple(names))


def _of_pandas_index(argument: str, index: Any) -> Labels | None:
    name = "" if index.name is None else str(index.name)
    if type(index).__name__ == "PeriodIndex":
        return labels_of(argument, index.to_timestamp().to_numpy(), name, period=index.freqstr)
    return labels_of(argument, index, name)


def _polars(argument: str, value: Any) -> tuple[Any, Labels | None]:
    value = value.collect() if type(value).__name__ == "LazyFrame" else value
    if type(value).__name__ == "Series":
        column = np.asarray(checks.as_numbers(argument, value.to_numpy()))
        return (column[:, None] if column.ndim == 1 else column), _with_columns(None, (value.name,) if value.name else ())
    dates = [name for name, kind in value.schema.items() if str(kind).startswith("Date")]
    labels = None
    if len(dates) == 1:
        stamps = value[dates[0]]
        zone = getattr(stamps.dtype, "time_zone", None)
        stamps = stamps.dt.convert_time_zone("UTC").dt.replace_time_zone(None) if zone else stamps
        labels = labels_of(argument, stamps.to_numpy(), dates[0], zone or "")
    names = [name for name in value.columns if name not in (dates if len(dates) == 1 else ())]
    columns = [np.asarray(checks.as_numbers(f"{argument} column {name!r}", value[name].to_numpy())) for name in names]
    return np.stack(columns, axis=1) if columns else np.zeros((value.height, 0)), _with_columns(labels, tuple(names))


def _time_axis(value: Any) -> str | None:
    """Return the dimension of xarray's object along which time goes: that with times, that of the name, or the first."""
    timed = [name for name in value.dims if name in value.coords and value.coords[name].dtype.kind in "mM"]
    return timed[0] if len(timed) == 1 else "time" if "time" in value.dims else next(iter(value.dims), None)


def _data_array(argument: str, value: Any, along: Any = None) -> tuple[Any, Labels | None]:
    along = _time_axis(value) if along is None else along
    if along is None:
        return checks.as_numbers(argument, value.to_numpy()), None
    turned = value.transpose(along, ...)
    array = checks.as_numbers(argument, turned.to_numpy())
    labels = labels_of(argument, value.coords[along].to_numpy(), str(along)) if along in value.coords else None
    if array.ndim == 1:
        return array[:, None], _with_columns(labels, () if value.name is None else (str(value.name),))
    named = array.ndim == 2 and turned.dims[1] in value.coords
    return array, _with_columns(labels, tuple(map(str, value.coords[turned.dims[1]].to_numpy())) if named else ())


def _dataset(argument: str, value: Any) -> tuple[Any, Labels | None]:
    along = _time_axis(value)
    arrays, columns, labels = [], [], None
    for name, variable in value.data_vars.items():
        if along not in variable.dims or variable.ndim > 2:
            checks.refuse(f"{argument}[{name!r}]", f"a variable along {along!r}, of two dimensions at most",
                          f"dimensions {', '.join(map(str, variable.dims)) or 'none'}", "Select variables: data[['a', 'b']].")  # fmt: skip
        array, labels = _data_array(f"{argument}[{name!r}]", variable, along)
        arrays.append(array)
        own = (labels and labels.columns) or range(array.shape[1])
        columns += [str(name)] if variable.ndim == 1 else [f"{name} {label}" for label in own]
    if not arrays:
        checks.refuse(argument, "a Dataset with variables", "one without any")
    return np.concatenate(arrays, axis=1), _with_columns(labels, tuple(columns))


def by_name(value: Any) -> Any:
    """Return a Dataset of xarray as a dictionary of its variables; anything else as it is."""
    return {str(name): variable for name, variable in value.data_vars.items()} if _kind(value) == ("xarray", "Dataset") else value


def plain(argument: str, value: Any) -> Any:
    """Return the numbers of data without labels; a series stays one row of numbers, `(t,)`. See `unlabelled`."""
    found, _ = unlabelled(argument, value)
    return found[:, 0] if found is not value and np.shape(found)[1:] == (1,) and len(getattr(value, "shape", ())) == 1 else found


def by_columns(argument: str, value: Any, names: tuple[str, ...]) -> Any:
    """Return the numbers of a table, `(t, x)`: the columns of these names in this order where it has any of them; anything else as it is.

    Args:
        argument: what it is called in messages.
        value: a table or series of another library, or an array.
        names: of the columns.

    Raises:
        MotesError: it holds something that is no number, or has only some of the columns.
    """
    found, labels = unlabelled(argument, value)
    columns = () if labels is None else labels.columns
    if not set(names) & set(columns):
        return found
    if not set(names) <= set(columns):
        checks.refuse(argument, f"the columns {', '.join(names)}", ", ".join(columns))
    return found[:, [columns.index(name) for name in names]]


_READERS = {
    ("pandas", "Series"): _pandas, ("pandas", "DataFrame"): _pandas, ("polars", "Series"): _polars, ("polars", "DataFrame"): _polars,
    ("polars", "LazyFrame"): _polars, ("xarray", "DataArray"): _data_array, ("xarray", "Dataset"): _dataset,
}  # fmt: skip
"""What takes labels off, by library and class."""


def _kind(value: Any) -> tuple[str, str] | None:
    """Return library and class of a table or series; classes that users derive of them count."""
    names = ((kind.__module__.partition(".")[0], kind.__name__) for kind in type(value).__mro__)
    return next((name for name in names if name in _READERS), None)
