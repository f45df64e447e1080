"""Fly filters over terrain and write what came out: shared by `motes demo terrain` and `motes run`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from motes.applications.terrain_navigation import scenario
from motes.applications.terrain_navigation.model import corrected, places_of
from motes.applications.terrain_navigation.roughness import roughness
from motes.cli import running
from motes.core import checks
from motes.filters.interface import Filter
from motes.plotting.plot import plot
from motes.plotting.terrain import Tracks, error_figure, map_figure


def fly(flight: scenario.Flight, filters: Mapping[str, Filter], seed: int, settings: Any, out: str) -> Path:
    """Tell whether the terrain is rough enough, run filters over a flight, print a table, and write histories, a summary and pictures.

    Args:
        flight: what was measured.
        filters: by name; pictures show the first.
        seed: of the filters.
        settings: what the user set, for the summary.
        out: folder for the files.

    Returns:
        The folder.

    Raises:
        MotesError: a filter does not fit, collapsed, or a file cannot be written.
    """
    for module in ("matplotlib.figure", "xarray", "h5netcdf"):
        checks.need(module, "results")  # where one is missing, say so before the work and not after it
    running.check_folder(out)
    print(roughness(flight.model, flight.inputs))
    outcomes = running.race(seed, filters, flight.model, flight.ys, flight.inputs)
    scores = {name: scenario.score(outcome.history, flight) for name, outcome in outcomes.items()}
    found = {name: running.results(outcome) | _scores(scores[name]) for name, outcome in outcomes.items()}
    head = ("filter", "n", "final, m", "median, m", "ESS", "ms/step")
    rows = [
        (name, str(outcome.filter.n), running.number(found[name].get("final_error_m"), 1),  # type: ignore[attr-defined]
         running.number(found[name].get("median_error_m"), 1), running.number(found[name]["median_ess"], 0),
         running.number(found[name]["milliseconds_per_step"], 2))
        for name, outcome in outcomes.items()
    ]
    running.show(f"{flight.ys.shape[0]} fixes over {flight.seconds[-1]:.0f} s; horizontal errors", head, rows)
    folder = running.made_folder(out)
    for name, outcome in outcomes.items():
        outcome.history.save(folder / f"{name}.nc")
    for name, figure in _pictures(flight, outcomes).items():
        running.write_figure(folder / name, figure)
    running.write_summary(folder / "summary.json", settings, found)
    running.told(outcomes)
    return folder


def _scores(score: scenario.Score | None) -> dict[str, Any]:
    return {} if score is None else {"final_error_m": score.final, "median_error_m": score.median, "lost": score.lost}


def _pictures(flight: scenario.Flight, outcomes: Mapping[str, running.Outcome]) -> dict[str, Any]:
    first, outcome = next(iter(outcomes.items()))
    history = outcome.history
    across = np.array(places_of(history.names)[:2])
    covs = np.asarray(history.cov)[:, across[:, None], across]
    inertial = (np.asarray(flight.inputs.north), np.asarray(flight.inputs.east))
    north, east, _ = corrected(flight.inputs, history.mean, history.names)
    true = None if flight.truth is None else (np.asarray(flight.truth[:, 0]), np.asarray(flight.truth[:, 1]))
    tracks = Tracks(inertial, (np.asarray(north), np.asarray(east)), covs, true)
    pictures = {
        "map.png": map_figure(flight.terrain, tracks, f"{first} filter, {outcome.filter.n} particles"),  # type: ignore[attr-defined]
        "states.png": plot(history, truth=flight.errors),
    }
    if true is not None:
        found = {name: corrected(flight.inputs, one.history.mean, history.names) for name, one in outcomes.items()}
        errors = {name: scenario.horizontal_errors(places, flight) for name, places in found.items()}
        deviation = np.sqrt(covs[:, 0, 0] + covs[:, 1, 1])
        pictures["error.png"] = error_figure(flight.seconds, errors | {"inertial only": scenario.horizontal_errors(inertial, flight)},
                                             deviation, scenario.LOST)
    return pictures
