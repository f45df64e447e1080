"""`motes run MODULE:FUNCTION --data FILE --filter NAME`: run a filter on the user's own model and measurements.

In place of MODULE:FUNCTION a TOML file may come that has it as `application`, with the tables [data], [filter] and [smoother]. Writes to
the folder `--out`: the history as NetCDF and as NPZ, `summary.json`, `states.png`, and `smoothed.csv` where a smoother is named.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from motes.cli.compiled import keep_programs
from motes.cli.options import check_seed, refuse
from motes.cli.own import Data, made, measured, read, settings_of
from motes.cli.records import build

if TYPE_CHECKING:
    from motes.smoothers.interface import Smoothed

USAGE = "motes run MODULE:FUNCTION"


@dataclass(frozen=True)
class Own:
    """Run a filter on your own model; MODULE:FUNCTION or FILE.py:FUNCTION comes first, or a TOML file that has it as `application`.

    `--filter NAME` chooses the filter, `--filter.n 2000` and so on its parameters, by the names that it has in Python; `--smoother NAME`
    likewise.

    Attributes:
        application: module and function that returns the model.
        data: the measurements (`--data FILE` is short for `--data.file FILE`).
        seed: of the filter.
        out: folder for the results.
    """

    application: str = ""
    data: Data = Data()
    seed: int = 0
    out: str = field(default="out", metadata={"path": True})


def main(words: Sequence[str]) -> None:
    """Run what is asked for.

    Raises:
        MotesError: an option, a file or the user's function cannot be used.
    """
    settings, choices = settings_of(Own, words, USAGE)
    check_seed(settings.seed)
    if "filter" not in choices:
        refuse("filter", "a filter by name", "none", "Give --filter particle --filter.n 1000, or a table [filter].")
    keep_programs()
    import numpy as np

    from motes.cli import running
    from motes.filters.interface import Filter
    from motes.smoothers.interface import Smoother

    running.check_folder(settings.out)
    arrays = read(settings.data) if settings.data.file else None
    model, given = made(settings.application, choices["folder"], arrays)
    if arrays is not None and "ys" not in given:
        found = measured(settings.data, arrays, model)
        given = {"ys": found.ys, "inputs": found.inputs, "truth": found.truth} | given
    if "ys" not in given:
        refuse("data file", "a file of measurements", "none", "Give --data FILE, or return 'ys' from the function.")
    filter = build(Filter, choices["filter"], "filter")
    smoother = build(Smoother, choices["smoother"], "smoother") if "smoother" in choices else None
    outcome = running.one(settings.seed, filter, model, given["ys"], given.get("inputs"), laws=smoother is not None)
    history, truth = outcome.history, given.get("truth")
    found = running.results(outcome)
    if truth is not None:
        errors = np.asarray(history.mean) - np.asarray(truth)
        found["rmse"] = {name: float(np.sqrt(np.mean(errors[:, i] ** 2))) for i, name in enumerate(history.names)}
    print(history)
    if truth is not None:
        print("rms errors      " + ", ".join(f"{name} {value:.4g}" for name, value in found["rmse"].items()))
    folder = running.made_folder(settings.out)
    history.save(folder / "history.nc")
    history.save(folder / "history.npz")
    if smoother is not None:
        _write_smoothed(folder / "smoothed.csv", running.smoothed(settings.seed, smoother, model, history, given))
    from motes.plotting.plot import plot

    running.write_figure(folder / "states.png", plot(history, truth=truth))
    running.write_summary(folder / "summary.json", settings, {history.label: found})
    running.told({"filter": outcome})
    print(f"Results are in {folder}.")


def _write_smoothed(path: Any, smoothed: "Smoothed") -> None:
    import numpy as np

    from motes.io.result_table import Table

    spread = np.sqrt(np.diagonal(np.asarray(smoothed.cov), axis1=1, axis2=2))
    columns = ("step", *smoothed.names, *(f"sd {name}" for name in smoothed.names))
    both = np.concatenate([np.asarray(smoothed.mean), spread], axis=1)
    rows = [(step, *map(float, row)) for step, row in enumerate(both)]
    Table(columns, tuple(rows)).save(path)
