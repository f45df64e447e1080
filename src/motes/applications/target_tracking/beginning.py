"""The beginning of tracks, M of N: so many scans of so many have a plot on one line that an aircraft could fly.

Two plots say places and a velocity, which their own range rates must agree with; other scans support it with a plot near the line.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from motes.applications.target_tracking.settings import Radar
from motes.core import checks

SCANS, SUPPORT = 5, 3
"""N and M."""
GATE = 4.0
"""Standard deviations within which a plot supports a line, or is one that a track explains."""
MANEUVER = 2.0
"""Acceleration that a line is allowed, m/s^2."""


class Beginning(NamedTuple):
    """Where a track begins.

    Attributes:
        scan: number of the second of the two scans whose plots it is made of.
        mean: east, north and velocities `(4,)` at that time.
        cov: `(4, 4)`.
    """

    scan: int
    mean: np.ndarray
    cov: np.ndarray


class _Line(NamedTuple):
    """A beginning, how many scans support it and how far off their plots are, squared; and the plots `(scan, plot)` that do."""

    begin: Beginning
    support: int
    off: float
    plots: list[tuple[int, int]]


def begun(times: np.ndarray, scans: list[np.ndarray], radar: Radar) -> Beginning:
    """Find where the first track begins: the first N scans of which M have a plot on one line, by the pair of plots with most support.

    Args:
        times: of the scans.
        scans: plots of each.
        radar: its accuracy.

    Raises:
        MotesError: no scans have so many.
    """
    found = begins(times, scans, radar)
    if found is None:
        checks.refuse("data", f"{SUPPORT} of {SCANS} scans with plots on a line that an aircraft could fly", f"none in {len(scans)} scans",
                      "Look at the units of the columns, and at the accuracy under [radar].")  # fmt: skip
    return found


def begins(times: np.ndarray, scans: list[np.ndarray], radar: Radar) -> Beginning | None:
    """Return where the first track begins, as for `begun`; None where none does."""
    for first in range(len(scans) - SUPPORT + 1):
        last = min(first + SCANS, len(scans))
        size = last - first
        best = _best(times[first:last], scans[first:last], [(i, j) for i in range(size) for j in range(i + 1, size)], radar)
        if best is not None:
            return best.begin._replace(scan=first + best.begin.scan)
    return None


def beginnings(times: np.ndarray, scans: list[np.ndarray], radar: Radar) -> list[Beginning]:
    """Find all tracks that begin at the last of some scans, the present one; no two of them share a plot.

    Args:
        times: of the last N scans.
        scans: plots of each that no track explains.
        radar: its accuracy.
    """
    scans, found = list(scans[-SCANS:]), []
    times, last = times[-SCANS:], len(scans) - 1
    while (best := _best(times, scans, [(i, last) for i in range(last)], radar)) is not None:
        found.append(best.begin)
        for scan, plot in best.plots:
            scans[scan] = np.delete(scans[scan], plot, axis=0)
    return found


def explained(mean: np.ndarray, cov: np.ndarray, plots: np.ndarray, radar: Radar) -> np.ndarray:
    """Tell which plots `(m, 3)` of a scan may be those of a track at its time, by its mean `(4,)` and covariance `(4, 4)`; `(m,)`."""
    places, covs = _placed(plots, radar)
    along = np.stack([np.cos(plots[:, 1]), np.sin(plots[:, 1])], axis=1)
    H = np.zeros((len(plots), 3, 4))
    H[:, 0, 0] = H[:, 1, 1] = 1.0
    H[:, 2, 2:] = along
    noise = np.zeros((len(plots), 3, 3))
    noise[:, :2, :2], noise[:, 2, 2] = covs, radar.rate**2
    off = np.concatenate([places, plots[:, 2:]], axis=1) - H @ mean
    return _squares(off, H @ cov @ H.transpose(0, 2, 1) + noise) < GATE**2


def _best(times: np.ndarray, scans: list[np.ndarray], pairs: Iterable[tuple[int, int]], radar: Radar) -> _Line | None:
    """Return the line through plots of two scans, of those that are named, that has most support, if that is enough."""
    best = None
    for i, j in pairs:
        for a, b in _agreeing(scans[i], scans[j], times[j] - times[i], radar):
            mean, cov = _line(scans[i][a], scans[j][b], times[j] - times[i], radar)
            others = [(k, _off(mean, cov, times[k] - times[j], scans[k], radar)) for k in range(len(scans)) if k not in (i, j)]
            near = [(k, int(np.argmin(squares)), float(np.min(squares))) for k, squares in others
                    if squares.size and np.min(squares) < GATE**2]  # fmt: skip
            line = _Line(Beginning(j, mean, cov), 2 + len(near), sum(square for *_, square in near),
                         [(i, a), (j, b), *((k, plot) for k, plot, _ in near)])  # fmt: skip
            if line.support >= SUPPORT and (best is None or (line.support, -line.off) > (best.support, -best.off)):
                best = line
    return best


def _agreeing(before: np.ndarray, after: np.ndarray, apart: float, radar: Radar) -> np.ndarray:
    """Indices `(k, 2)` of pairs of plots of two scans between which an aircraft could have flown, at the range rates of both."""
    (one, cov_one), (two, cov_two) = _placed(before, radar), _placed(after, radar)
    velocity = (two - one[:, None]) / apart
    possible = np.hypot(velocity[..., 0], velocity[..., 1]) <= radar.fastest
    wide = (cov_two + cov_one[:, None]) / apart**2 + (0.5 * MANEUVER * apart) ** 2 * np.eye(2)
    for plots in (before[:, None], after[None]):
        along = np.stack([np.cos(plots[..., 1]), np.sin(plots[..., 1])], axis=-1)
        spread = np.sqrt(np.einsum("...i,...ij,...j->...", along, wide, along) + radar.rate**2)
        possible &= np.abs(np.sum(along * velocity, axis=-1) - plots[..., 2]) <= GATE * spread
    return np.argwhere(possible)


def _placed(plots: np.ndarray, radar: Radar) -> tuple[np.ndarray, np.ndarray]:
    """East and north of plots `(..., 3)`, and their covariances `(..., 2, 2)`."""
    distance, azimuth = plots[..., 0], plots[..., 1]
    along = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    across = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    turn = np.stack([along, across], axis=-1)
    variances = np.stack([np.full_like(distance, radar.distance**2), (radar.azimuth * distance) ** 2], axis=-1)
    return distance[..., None] * along, (turn * variances[..., None, :]) @ np.swapaxes(turn, -1, -2)


def _line(a: np.ndarray, b: np.ndarray, apart: float, radar: Radar) -> tuple[np.ndarray, np.ndarray]:
    """State at the second of two plots, and its covariance; maneuvers between them widen that of the velocity."""
    (before, cov_a), (place, cov_b) = _placed(a, radar), _placed(b, radar)
    wide = (cov_a + cov_b) / apart**2 + (0.5 * MANEUVER * apart) ** 2 * np.eye(2)
    return np.concatenate([place, (place - before) / apart]), np.block([[cov_b, cov_b / apart], [cov_b / apart, wide]])


def _off(mean: np.ndarray, cov: np.ndarray, ahead: float, plots: np.ndarray, radar: Radar) -> np.ndarray:
    """Squared distances `(m,)` of the plots of a scan from a line, in standard deviations."""
    F = np.block([[np.eye(2), ahead * np.eye(2)], [np.zeros((2, 2)), np.eye(2)]])
    place, wide = (F @ mean)[:2], (F @ cov @ F.T)[:2, :2] + (0.5 * MANEUVER * ahead**2) ** 2 * np.eye(2)
    at, own = _placed(plots, radar)
    return _squares(at - place, wide + own)


def _squares(off: np.ndarray, covs: np.ndarray) -> np.ndarray:
    """Squared distances `(m,)` of differences `(m, z)` in standard deviations of covariances `(m, z, z)`."""
    return np.sum(off * np.linalg.solve(covs, off[..., None])[..., 0], axis=-1)
