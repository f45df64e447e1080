"""Distances between sets of points, for estimates and truths whose numbers differ."""

from typing import Any, NamedTuple

import numpy as np

from motes.core import checks


def ospa(estimates: Any, truths: Any, cutoff: float, order: float = 2.0) -> float:
    """Optimal subpattern assignment distance (Schuhmacher, Vo, Vo 2008), in the units of the points, at most the cutoff.

    Args:
        estimates: points `(m, x)`.
        truths: points `(n, x)`.
        cutoff: distance from which on a pair counts as missed; a surplus point counts as much.
        order: p of the average over pairs.

    Raises:
        MotesError: the points do not fit each other, the cutoff is not positive, or the order is below 1.
    """
    from scipy.optimize import linear_sum_assignment

    near = _cut("ospa", estimates, truths, cutoff, order)
    fewer, more = sorted(near.shape)
    if more == 0:
        return 0.0
    paired = near[linear_sum_assignment(near)].sum()
    return float(((paired + cutoff**order * (more - fewer)) / more) ** (1 / order))


class Gospa(NamedTuple):
    """Generalized optimal subpattern assignment distance and what it is made of.

    Attributes:
        distance: the whole, in the units of the points.
        localization: sum over pairs of their distances to the power p.
        missed: number of truths without an estimate.
        false: number of estimates without a truth.
    """

    distance: float
    localization: float
    missed: int
    false: int


def gospa(estimates: Any, truths: Any, cutoff: float, order: float = 2.0) -> Gospa:
    """Generalized optimal subpattern assignment distance with alpha = 2 (Rahmathullah, Garcia-Fernandez, Svensson 2017).

    Not divided by the number of points: localization + (cutoff^p / 2) (missed + false), to the power 1 / p.

    Args:
        estimates: points `(m, x)`.
        truths: points `(n, x)`.
        cutoff: distance from which on two points are no pair.
        order: p.

    Raises:
        MotesError: the points do not fit each other, the cutoff is not positive, or the order is below 1.
    """
    from scipy.optimize import linear_sum_assignment

    near = _cut("gospa", estimates, truths, cutoff, order)
    rows, columns = linear_sum_assignment(near)
    pairs = near[rows, columns]
    pairs = pairs[pairs < cutoff**order]
    missed, false = near.shape[1] - pairs.size, near.shape[0] - pairs.size
    whole = pairs.sum() + cutoff**order / 2 * (missed + false)
    return Gospa(float(whole ** (1 / order)), float(pairs.sum()), missed, false)


def swaps(estimates: Any, truths: Any, cutoff: float) -> int:
    """Count how often a target is followed by another track than before (mismatches: Bernardin, Stiefelhagen 2008).

    A track stays with its target while the two are nearer than the cutoff; the others are paired so that their distances have the least
    sum. Two tracks that exchange their targets are two swaps.

    Args:
        estimates: points of the tracks over time, `(t, m, x)`; a point of NaN is not there.
        truths: those of the targets, `(t, n, x)`.
        cutoff: distance from which on two points are no pair.

    Raises:
        MotesError: the points do not fit each other, or the cutoff is not positive.
    """
    return int(changes(followers(estimates, truths, cutoff)).sum())


def changes(tracks: np.ndarray) -> np.ndarray:
    """Count, for each target, the swaps `(n,)` among the tracks `(t, n)` that follow it, -1 for none."""
    counts = np.zeros(tracks.shape[1], int)
    for target, column in enumerate(tracks.T):
        known = column[column >= 0]
        counts[target] = np.sum(known[1:] != known[:-1])
    return counts


def followers(estimates: Any, truths: Any, cutoff: float) -> np.ndarray:
    """Return which track follows each target, `(t, n)`, -1 where none does; see `swaps`."""
    from scipy.optimize import linear_sum_assignment

    shapes = [np.shape(points) for points in (estimates, truths)]
    if len(shapes[0]) != 3 or len(shapes[1]) != 3 or shapes[0][0] != shapes[1][0]:
        checks.refuse("swaps estimates", "points (t, m, x), at as many steps as the truths", f"shapes {shapes[0]} and {shapes[1]}")
    found = np.full(shapes[1][:2], -1)
    track_of: dict[int, int] = {}
    for step, (own, true) in enumerate(zip(np.asarray(estimates), np.asarray(truths), strict=True)):
        there = [np.flatnonzero(~np.isnan(np.asarray(points, np.float64)).all(axis=1)) for points in (own, true)]
        near = np.full((len(own), len(true)), float(cutoff))
        near[np.ix_(*there)] = _cut("swaps", own[there[0]], true[there[1]], cutoff, 1.0)
        kept: dict[int, int] = {}
        for target, track in sorted(track_of.items(), key=lambda pair: near[pair[1], pair[0]]):
            if near[track, target] < cutoff and track not in kept.values():
                kept[target] = track
        free = [track for track in range(near.shape[0]) if track not in kept.values()]
        left = [target for target in range(near.shape[1]) if target not in kept]
        for row, column in zip(*linear_sum_assignment(near[np.ix_(free, left)]), strict=True):
            if near[free[row], left[column]] < cutoff:
                kept[left[column]] = free[row]
        track_of |= kept
        found[step, list(kept)] = list(kept.values())
    return found


def _cut(asked_by: str, estimates: Any, truths: Any, cutoff: float, order: float) -> np.ndarray:
    """Distances `(m, n)`, at most the cutoff, to the power of the order."""
    checks.above_zero(f"{asked_by} cutoff", cutoff)
    if not order >= 1:
        checks.refuse(f"{asked_by} order", "a number of at least 1", order)
    one, other = (np.asarray(checks.as_numbers(asked_by, points), np.float64) for points in (estimates, truths))
    for name, points in (("estimates", one), ("truths", other)):
        if points.ndim != 2 or not np.isfinite(points).all():
            checks.refuse(f"{asked_by} {name}", "finite points, shape (n, x)", f"shape {points.shape}")
    if one.shape[1] != other.shape[1]:
        checks.refuse(f"{asked_by} estimates", f"points of {other.shape[1]} components, as the truths", f"{one.shape[1]}")
    apart = np.linalg.norm(one[:, None] - other[None], axis=-1)
    return np.minimum(apart, cutoff) ** order
