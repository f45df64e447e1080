"""Flights: simulated over a map, or loaded from the user's files, and how well a run found the way."""

from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.applications.terrain.coverage import check_covered, over_map, without_far_voids
from motes.applications.terrain.cruise import Cruise, cruise_of
from motes.applications.terrain.model import Track, corrected, error_model
from motes.applications.terrain.readings import check_readings, check_seconds
from motes.applications.terrain.recording import check_recording, check_steps, local, misreadings, read_recording
from motes.applications.terrain.settings import (
    FIRST,
    INERTIAL,
    NOISES,
    PRIOR,
    Inertial,
    MapFiles,
    Noises,
    Prior,
    Recording,
    Route,
)
from motes.core import checks
from motes.core.record import record, replace, static
from motes.core.types import KeyLike
from motes.filters.history import History
from motes.io.clocks import Clock
from motes.io.rasters import jacksboro, mosaic, read_raster
from motes.io.units import converted
from motes.models.simulate import simulate
from motes.models.state_space import StateSpaceModel
from motes.models.terrain import TerrainMap, terrain_map

LOST = 150.0
"""A run whose final horizontal error exceeds this many meters is lost."""
EVEN = 1e-3
"""Fixes whose spacing varies by less than this share of it count as evenly spaced."""


@record
class Flight:
    """Everything a filter needs of one flight, and what is known of the truth.

    Attributes:
        model: the model of the inertial errors.
        terrain: the map.
        ys: heights above terrain, `(t, 1)`, m.
        inputs: the inertial track.
        seconds: time of each fix since the first, `(t,)`, float64.
        truth: true north and east, `(t, 2)`, m; None if not known.
        errors: true inertial errors `(t, x)`, where they were simulated; otherwise None.
        start: time of the first fix in the recording, s (of dates Unix seconds).
        clock: how times are written there.
    """

    model: StateSpaceModel
    terrain: TerrainMap
    ys: jax.Array
    inputs: Track
    seconds: np.ndarray
    truth: jax.Array | None = None
    errors: jax.Array | None = None
    start: float = static(default=0.0)
    clock: Clock = static(default=Clock())


class Score(NamedTuple):
    """Horizontal errors of an estimate, meters.

    Attributes:
        final: at the last fix.
        median: over the second half of the flight.
        lost: whether the final one exceeds `LOST`.
    """

    final: float
    median: float
    lost: bool


def simulated(
    key: KeyLike,
    terrain: TerrainMap | None = None,
    route: Route = FIRST,
    noises: Noises = NOISES,
    prior: Prior = PRIOR,
    kind: Inertial = INERTIAL,
    outside: str = "refuse",
) -> Flight:
    """Fly a route with inertial errors drawn from the model's own law.

    Args:
        key: JAX key or integer seed.
        terrain: the map; that of the Jacksboro fault if not given.
        route: the true flight.
        noises: standard deviations of process and altimeter.
        prior: standard deviations at the first fix.
        kind: nine error states or fifteen.
        outside: as in `MapFiles`, of a route that leaves the map.

    Raises:
        MotesError: the route leaves the map.
    """
    terrain = _bounded(terrain_map(jacksboro()) if terrain is None else terrain, outside)
    checks.positive_integer("route fixes", route.fixes)
    seconds = np.arange(route.fixes) * route.step
    heading = np.radians(route.heading)
    north = route.north + route.speed * seconds * np.cos(heading)
    east = route.east + route.speed * seconds * np.sin(heading)
    altitude = np.full_like(north, float(np.nanmax(np.asarray(terrain.heights))) + route.clearance)
    model = error_model(terrain, noises, prior, route.step, kind, _cruise(kind, terrain, (north, east, altitude), seconds))
    check_covered(terrain, north, east, "the flight")
    truth = Track(*(jnp.asarray(part, model.dtype) for part in (north, east, altitude)))
    # the errors depend neither on inputs nor on voids, so drawing twice with one key gives them, then the fixes that belong to them
    errors, _ = simulate(key, model, route.fixes, truth)
    inertial = Track(*corrected(truth, -errors, model.names))
    model = without_far_voids(model, inertial, noises.altimeter)
    errors, ys = simulate(key, model, route.fixes, inertial)
    return Flight(model, terrain, over_map(terrain, inertial, ys), inertial, seconds, jnp.stack([truth.north, truth.east], axis=1), errors)


def _bounded(terrain: TerrainMap, outside: str) -> TerrainMap:
    checks.option("map outside", outside, ("refuse", "missing"))
    return replace(terrain, beyond="edge" if outside == "refuse" else "void")


def _cruise(kind: Inertial, terrain: TerrainMap, track: tuple[np.ndarray, ...], seconds: np.ndarray) -> Cruise | None:
    return None if kind.states == 9 else cruise_of(terrain, np.stack(track, axis=1), seconds)


def jacksboro_file() -> Path:
    """Return where matplotlib keeps the map of the Jacksboro fault."""
    return Path(checks.need("matplotlib.cbook", "results").get_sample_data("jacksboro_fault_dem.npz", asfileobj=False))


def load_map(files: MapFiles) -> TerrainMap:
    """Read and join the files of a map.

    Raises:
        FileError: a file is damaged or does not fit the others.
        MotesError: no file is named, or what to do outside of them is no word for it.
    """
    if not files.files:
        checks.refuse("map files", "at least one file of heights", "none")
    found = mosaic([read_raster(file, nodata=files.nodata) for file in files.files])
    if files.unit != "m":
        found = replace(found, heights=converted("map unit", found.heights, files.unit, "m"))
    return _bounded(terrain_map(found), files.outside)


def loaded(
    files: MapFiles, recording: Recording, noises: Noises = NOISES, prior: Prior = PRIOR, kind: Inertial = INERTIAL
) -> Flight:
    """Load a recorded flight.

    Args:
        files: the map.
        recording: the table with the inertial track and the altimeter.
        noises: standard deviations of process and altimeter.
        prior: standard deviations at the first fix.
        kind: nine error states or fifteen.

    Raises:
        FileError: a file is missing, damaged or lacks a column; the message names it.
        MotesError: times decrease, the track has gaps, the map does not cover it, or it is none for fifteen states.
    """
    check_recording(recording)
    terrain = load_map(files)
    table = read_recording(terrain, recording)
    name = Path(recording.file).name
    rows = table[recording.height].size
    start, seconds = table.times(recording.time, repeats=False) if recording.time else (0.0, np.arange(rows) * recording.step)
    step, since = _spacing(seconds, recording.step)
    north, east = local(terrain, recording, table, recording.inertial)
    check_seconds(recording, table, seconds, (north, east))
    check_steps(name, seconds)
    check_covered(terrain, north, east, f"the inertial track in {name}", misreadings(terrain, recording, table))
    check_readings(terrain, files, recording, table, (north, east), prior)
    altitude = table[recording.inertial[2]]
    dtype = terrain.heights.dtype
    inertial = Track(*(jnp.asarray(part, dtype) for part in (north, east, altitude)))
    if since is not None:
        inertial = replace(inertial, since=jnp.asarray(since, dtype))
    cruise = _cruise(kind, terrain, (north, east, altitude), seconds)
    model = without_far_voids(error_model(terrain, noises, prior, step, kind, cruise), inertial, noises.altimeter)
    truth = jnp.asarray(np.stack(local(terrain, recording, table, recording.truth), axis=1), dtype) if recording.truth else None
    ys = over_map(terrain, inertial, jnp.asarray(table[recording.height][:, None], dtype))
    clock = table.clocks.get(recording.time, Clock())
    return Flight(model, terrain, ys, inertial, seconds, truth, start=start, clock=clock)


def _spacing(seconds: np.ndarray, otherwise: float) -> tuple[float | None, np.ndarray | None]:
    """Return the step where fixes are evenly spaced, and otherwise the seconds since the fix before."""
    steps = np.diff(seconds)
    if not steps.size:
        return otherwise, None
    usual = float(np.median(steps))
    if np.abs(steps - usual).max() <= EVEN * usual:
        return float(steps.mean()), None
    return None, np.concatenate([[usual], steps])


def horizontal_errors(positions: tuple[Any, ...], flight: Flight) -> np.ndarray:
    """Return the distance `(t,)` of positions (north and east, each `(t,)`) from the truth, meters."""
    truth = np.asarray(flight.truth, np.float64)
    return np.hypot(np.asarray(positions[0]) - truth[:, 0], np.asarray(positions[1]) - truth[:, 1])


def score(history: History, flight: Flight) -> Score | None:
    """Judge a run by the truth; None where that is not known."""
    if flight.truth is None:
        return None
    errors = horizontal_errors(corrected(flight.inputs, history.mean, history.names), flight)
    final = float(errors[-1])
    return Score(final, float(np.median(errors[errors.size // 2:])), final > LOST)
