"""A recorded flight as a job for a tracker: the true path by a smoother, radar plots drawn from it, and the score."""

import os
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.applications.aircraft.model import Radar
from motes.applications.aircraft.reports import (
    EARTH,
    KNOT,
    LEAST,
    NAME,
    SHOWN,
    Reports,
    check_agreement,
    clock_of,
    heard_of,
    part_of,
    read_reports,
    wrapped_degrees,
)
from motes.core import checks
from motes.core.record import record
from motes.io.clocks import Clock
from motes.io.dialect import NAMED, NamedDialect
from motes.laws.gaussian import Gaussian
from motes.laws.observed import Observed

BEGIN, DURATION = 556.0, 4800.0
"""Part of the recording that is flown unless said otherwise, seconds."""
RADAR = (-25e3, -20e3)
"""East and north of the radar from the middle of the flight, meters."""
JERK, POSITION_SD, SPEED_SD, SOFT = 1.0, 50.0, 2.0, 6.0
"""The smoother: intensity of white jerk (m^2/s^5), deviations of what was reported (m, m/s), and residuals that are held for outliers."""
UNSCORED = 10
"""Plots at the start that are not scored."""
LOST = 1e3
"""A track is lost when it is further off at a plot, meters."""


class Path(NamedTuple):
    """The true path in meters from the radar.

    Attributes:
        times: seconds since its start, `(r,)`.
        states: east, north and velocities, `(r, 4)`.
        middle: latitude and longitude of the middle of the plane, degrees.
        radar: east and north of the radar from there, meters.
        start: time 0 in the recording, s (of dates Unix seconds).
        clock: how times are written there.
    """

    times: np.ndarray
    states: np.ndarray
    middle: tuple[float, float]
    radar: tuple[float, float]
    start: float = 0.0
    clock: Clock = Clock()

    def placed(self, east: np.ndarray, north: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return latitudes and longitudes, degrees, of places in meters from the radar."""
        longitude = self.middle[1] + np.degrees((east + self.radar[0]) / (EARTH * np.cos(np.radians(self.middle[0]))))
        return self.middle[0] + np.degrees((north + self.radar[1]) / EARTH), wrapped_degrees(longitude)


@record
class Track:
    """What a tracker is given, and what its answer is held against.

    Attributes:
        start: law of east, north and velocities by two plots.
        ys: range and azimuth of each step, `(t, 2)`, NaN where the radar saw nothing, or scans of such; those of the first step are in
            `start` already.
        dt: duration of each step, seconds, `(t,)`.
        truth: east, north and velocities, `(t, 4)`.
        scored: whether the step counts, `(t,)`.
    """

    start: Gaussian
    ys: np.ndarray | Observed
    dt: np.ndarray
    truth: np.ndarray
    scored: np.ndarray


class Score(NamedTuple):
    """How good a run was.

    Attributes:
        position: root mean square error at the scored plots, meters.
        velocity: the same of the velocity, m/s.
        worst: largest error of the position, meters; above `LOST` the track is lost.
    """

    position: jax.Array
    velocity: jax.Array
    worst: jax.Array


def read_path(
    file: str | os.PathLike[str],
    start: float = BEGIN,
    duration: float = DURATION,
    radar: tuple[float, float] = RADAR,
    aircraft: str = "",
    written: NamedDialect = NAMED,
) -> Path:
    """Read a recording of ADS-B reports (CSV, JSON or Parquet, also zipped by gzip) and smooth it.

    Reports without a position, or without a speed and a track, are left out, and so are repeated positions. Degrees are laid out evenly
    on a plane, with velocities stretched in the same way.

    Args:
        file: the recording, with the columns timestamp, latitude, longitude (degrees), groundspeed (knots) and track (degrees from north),
            and icao24 where there are several aircraft in it.
        start: of the part that is flown, seconds since the first report.
        duration: of that part, seconds; a recording may end before.
        radar: east and north of the radar from the middle of that part, meters.
        aircraft: icao24 of the one that is flown; "" where there is but one.
        written: how the table is written, and what its columns are called.

    Raises:
        FileError: the file cannot be used, or holds too little of the part that is asked for.
        MotesError: a setting cannot be used, or does not say which of several aircraft.
    """
    _check_part(start, duration, radar)
    found = read_reports(file, written)
    if aircraft and aircraft not in found or not aircraft and len(found) > 1:
        names = ", ".join(sorted(found)[:SHOWN]) + ", ..." * (len(found) > SHOWN) if found.keys() != {""} else f"no column {NAME}"
        checks.refuse("aircraft", f"the {NAME} of one in {os.fspath(file)[-80:]}: {names}", repr(aircraft)[:40] if aircraft else "none",
                      "motes run target_tracking follows all at once." if len(found) > 1 else "")  # fmt: skip
    table = found[aircraft] if aircraft else next(iter(found.values()))
    heard = heard_of(table)
    check_agreement(table.source, heard)
    if len(heard.timestamp) < LEAST:
        checks.refuse(table.source, f"at least {LEAST} reports of position and velocity",
                      f"{len(heard.timestamp)} of {len(table.places)} rows", error=checks.FileError)  # fmt: skip
    reports = part_of(heard, heard.timestamp[0], start, duration)
    if len(reports.timestamp) < LEAST:
        seconds = heard.timestamp[-1] - heard.timestamp[0]
        checks.refuse(table.source, f"at least {LEAST} positions from second {start:g} to {start + duration:g}",
                      f"{len(reports.timestamp)} in a recording of {seconds:.0f} s", "Set start and duration.",
                      checks.FileError)  # fmt: skip
    return path_of(reports, radar)._replace(start=float(heard.timestamp[0] + reports.timestamp[0]), clock=clock_of(table))


def read_paths(
    file: str | os.PathLike[str],
    start: float = BEGIN,
    duration: float = DURATION,
    radar: tuple[float, float] = RADAR,
    written: NamedDialect = NAMED,
) -> dict[str, Path]:
    """Read the paths of all aircraft of a recording, on one plane; see `read_path`.

    Returns:
        Paths by icao24; times are seconds since the start of the part. Aircraft with fewer than 10 positions in it are left out.

    Raises:
        FileError: the file cannot be used, or no aircraft has so many.
        MotesError: a setting cannot be used.
    """
    _check_part(start, duration, radar)
    tables = read_reports(file, written)
    heard = {name: heard_of(table) for name, table in tables.items()}
    for name, reports in heard.items():
        check_agreement(tables[name].source, reports)
    first = min((reports.timestamp[0] for reports in heard.values() if reports.timestamp.size), default=0.0)
    parts = {name: part_of(reports, first, start, duration) for name, reports in heard.items()}
    parts = {name: reports for name, reports in parts.items() if reports.timestamp.size >= LEAST}
    if not parts:
        checks.refuse(os.fspath(file)[-160:], f"an aircraft with {LEAST} positions from second {start:g} to {start + duration:g}",
                      f"{len(heard)} with fewer", "Set start and duration.", checks.FileError)  # fmt: skip
    everywhere = [np.concatenate(column) for column in zip(*parts.values(), strict=True)]
    middle, begins = _middle(Reports(*everywhere)), float(first + start)
    return {name: path_of(reports, radar, middle)._replace(times=reports.timestamp - start, start=begins, clock=clock_of(tables[name]))
            for name, reports in parts.items()}  # fmt: skip


def _check_part(start: float, duration: float, radar: tuple[float, float]) -> None:
    for name, value in (("start", start), ("radar east", radar[0]), ("radar north", radar[1])):
        checks.finite(name, value)
    checks.above_zero("duration", duration)


def path_of(reports: Reports, radar: tuple[float, float] = RADAR, middle: tuple[float, float] | None = None) -> Path:
    """Lay reports out on a plane and smooth them; see `read_path`.

    Args:
        reports: those of one flight, in order of time.
        radar: east and north of the radar from the middle, meters.
        middle: latitude and longitude of the middle of the plane, degrees; that of the flight if None.
    """
    time, latitude, longitude, speed, track = reports
    middle = middle or _middle(reports)
    shrink = np.cos(np.radians(middle[0]))
    east = EARTH * shrink * np.radians(wrapped_degrees(longitude - middle[1])) - radar[0]
    north = EARTH * np.radians(latitude - middle[0]) - radar[1]
    course = np.radians(track)
    stretch = shrink / np.cos(np.radians(latitude))
    axes = [smoothed(time, east, KNOT * speed * np.sin(course) * stretch), smoothed(time, north, KNOT * speed * np.cos(course))]
    states = np.stack([axes[0][:, 0], axes[1][:, 0], axes[0][:, 1], axes[1][:, 1]], axis=1)
    return Path(time - time[0], states, middle, radar, float(time[0]))


def _middle(reports: Reports) -> tuple[float, float]:
    return float(np.median(reports.latitude)), float(np.median(reports.longitude))


def smoothed(times: np.ndarray, position: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Return position, speed and acceleration `(r, 3)` along one axis by a Rauch-Tung-Striebel smoother with white jerk."""
    m, P = np.array([position[0], speed[0], 0.0]), np.diag([POSITION_SD**2, SPEED_SD**2, 1.0])
    filtered, predicted = [], []
    for dt, *seen in zip(np.diff(times, prepend=times[0]), position, speed, strict=True):
        F = np.array([[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]])
        g = np.array([[dt**5 / 20, dt**4 / 8, dt**3 / 6], [dt**4 / 8, dt**3 / 3, dt**2 / 2], [dt**3 / 6, dt**2 / 2, dt]])
        m, P = F @ m, F @ P @ F.T + JERK * g
        predicted.append((F, m, P))
        for i, (value, sd) in enumerate(zip(seen, (POSITION_SD, SPEED_SD), strict=True)):
            residual = value - m[i]
            variance = P[i, i] + sd**2
            variance *= max(1.0, residual**2 / (SOFT**2 * variance))
            gain = P[:, i] / variance
            m, P = m + gain * residual, P - np.outer(gain, P[i])
        filtered.append((m, P))
    states = [filtered[-1][0]]
    for (m, P), (F, ahead, wide) in zip(filtered[-2::-1], predicted[:0:-1], strict=True):
        states.append(m + P @ F.T @ np.linalg.solve(wide, states[-1] - ahead))
    return np.array(states[::-1])


def track(path: Path, seed: int, steps: int, radar: Radar) -> Track:
    """Draw the plots of a radar along a path.

    Plots come at intervals uniform on 1 to 5 s; some are missing, and all for 30 s in every 10 minutes. Steps beyond the end of the path
    have no plot. Where there are false plots, steps have scans, in which the aircraft's own comes at any place.

    Args:
        path: the true path.
        seed: of the plots.
        steps: number of steps; 1 800 reach the end of 80 minutes.
        radar: what it sees.

    Raises:
        MotesError: the path is too short for a plot that is scored.
    """
    checks.positive_integer("track steps", steps)
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(1, 5, steps + 1))
    states = np.stack([np.interp(times, path.times, column) for column in path.states.T], axis=1)
    distance = np.hypot(states[:, 0], states[:, 1]) + radar.distance * rng.standard_normal(steps + 1)
    azimuth = np.arctan2(states[:, 1], states[:, 0]) + radar.azimuth * rng.standard_normal(steps + 1)
    heard = (times % 600 < 570) & (times <= path.times[-1])
    seen = (rng.random(steps + 1) > 1 - radar.detection) & heard
    places = np.stack([distance * np.cos(azimuth), distance * np.sin(azimuth)], axis=1)
    apart = times[1] - times[0]
    covs = [_plane(distance[i], azimuth[i], radar) for i in (0, 1)]
    mean = np.concatenate([places[1], (places[1] - places[0]) / apart])
    cov = np.block([[covs[1], covs[1] / apart], [covs[1] / apart, (covs[0] + covs[1]) / apart**2]])
    ys: Any = np.where(seen[1:, None], np.stack([distance, azimuth], axis=1)[1:], np.nan)
    ys[0] = np.nan
    scored = seen[1:] & (np.arange(steps) >= UNSCORED)
    if not scored.any():
        checks.refuse("track path", f"one that lasts for more than {UNSCORED} plots (5 s each at most)", f"{path.times[-1]:.0f} s")
    kind = jnp.result_type(float)
    start = Gaussian(jnp.asarray(mean, kind), jnp.asarray(cov, kind))
    if radar.false:
        ys = _among_false(rng, ys, heard[1:] & (np.arange(steps) > 0), radar)
    ys = jax.tree.map(lambda leaf: leaf.astype(kind) if leaf.dtype == float else leaf, ys)
    return Track(start, ys, np.diff(times).astype(kind), states[1:].astype(kind), scored)


def _among_false(rng: np.random.Generator, own: np.ndarray, heard: np.ndarray, radar: Radar) -> Observed:
    """Return scans of the aircraft's own plots `(t, 2)` and of false ones, at the steps that are heard."""
    places = rng.uniform([0, -np.pi], [radar.farthest, np.pi], (len(own), radar.room, 2))
    count = np.minimum(rng.poisson(radar.false, len(own)), radar.room - 1)
    rows = np.where(np.arange(radar.room)[:, None] < count[:, None, None], places, np.nan)
    rows[:, -1] = np.stack([own[:, 0], (own[:, 1] + np.pi) % (2 * np.pi) - np.pi], axis=1)
    rows[~heard] = np.nan
    order = np.argsort(rng.random(rows.shape[:2]), axis=1)
    return Observed(np.take_along_axis(rows, order[..., None], axis=1), heard)


def _plane(distance: float, azimuth: float, radar: Radar) -> np.ndarray:
    """Covariance `(2, 2)` of the place of a plot in the plane."""
    turn = np.array([[np.cos(azimuth), -np.sin(azimuth)], [np.sin(azimuth), np.cos(azimuth)]])
    return turn @ np.diag([radar.distance**2, (radar.azimuth * distance) ** 2]) @ turn.T


def score(means: jax.Array, job: Track) -> Score:
    """Judge means `(t, x)` whose first four components are east, north and velocities. Pure, for jit and vmap."""
    off = jnp.square(means[:, :4] - job.truth)
    position, velocity = off[:, 0] + off[:, 1], off[:, 2] + off[:, 3]
    count = jnp.sum(job.scored)
    rms = [jnp.sqrt(jnp.sum(jnp.where(job.scored, part, 0)) / count) for part in (position, velocity)]
    return Score(rms[0], rms[1], jnp.sqrt(jnp.max(jnp.where(job.scored, position, 0))))
