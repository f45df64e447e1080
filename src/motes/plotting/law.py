"""Pictures of a law: a histogram of one state, or particles in the plane of two, with mean and ellipse of two standard deviations."""

from typing import Any

import jax
import numpy as np

from motes.core import checks
from motes.laws.law import Law
from motes.plotting.figures import ESTIMATE, INERTIAL, WORDS, legend_below, new_figure, one_scale, tidy, two_sigma

MOST = 20_000
"""Particles drawn at most."""
BINS = 60


def components(law: Law) -> int:
    """Return the number of components of a law.

    Raises:
        MotesError: there are many laws, as a run keeps them.
    """
    try:
        mean, points = jax.eval_shape(lambda law: (law.mean(), law.weighted_points()), law)
    except (TypeError, ValueError):
        mean, points = None, None
    if mean is None or mean.ndim != 1 or (points is not None and points[0].ndim != 2):
        checks.refuse("plot result", "one law", "many of them", "Take that of one step: jax.tree.map(lambda leaf: leaf[-1], history.law).")
    return mean.shape[0]


def law_figure(law: Law, names: tuple[str, ...], states: tuple[int, ...], title: str = "") -> Any:
    """Draw a law.

    Args:
        law: a cloud, or any other: of one that has no particles points are drawn.
        names: of all states.
        states: indices of the one or two to draw.
        title: over the picture.
    """
    mean, cov = np.asarray(law.mean(), np.float64), np.asarray(law.cov(), np.float64)
    points, weights = _points(law)
    figure = new_figure(5.5, 4.6)
    axes = figure.add_subplot()
    tidy(axes)
    axes.set_title(title, fontsize=10, **WORDS)
    axes.set_xlabel(names[states[0]], **WORDS)
    if len(states) == 1:
        _density(axes, points[states[0]], weights, mean[states[0]], np.sqrt(cov[states[0], states[0]]))
    else:
        pair = list(states)
        size = np.clip(weights * len(weights), 0.1, 20) * min(12.0, 2_000 / len(weights) + 1)
        axes.scatter(*points[pair], s=size, color=ESTIMATE, alpha=0.35, linewidths=0, label="particles, by weight", rasterized=True)
        axes.plot(*mean[pair, None], "+", color=INERTIAL, markersize=10, label="mean")
        two_sigma(axes, mean[pair], cov[np.ix_(pair, pair)], edgecolor=INERTIAL, linewidth=1.2, label="2 sigma")
        axes.set_ylabel(names[states[1]], **WORDS)
        axes.autoscale_view()
        one_scale(axes)
    legend_below(figure, axes, 3)
    return figure


def _points(law: Law) -> tuple[np.ndarray, np.ndarray]:
    """Return points `(x, n)` and their weights `(n,)`, at most so many; of a law without particles, or of very many, they are drawn."""
    found = law.weighted_points()
    if found is None or found[0].shape[-1] > MOST:
        drawn = np.asarray(law.sample(jax.random.key(0), MOST if found is not None else MOST // 10), np.float64)
        return drawn, np.full(drawn.shape[-1], 1 / drawn.shape[-1])
    points, log_weights = (np.asarray(one, np.float64) for one in found)
    return points, np.exp(log_weights)


def _density(axes: Any, points: np.ndarray, weights: np.ndarray, mean: float, deviation: float) -> None:
    axes.hist(points, bins=BINS, weights=weights, density=True, color=ESTIMATE, alpha=0.5, label="particles, by weight")
    axes.axvline(mean, color=INERTIAL, linewidth=1.2, label="mean")
    axes.axvspan(mean - 2 * deviation, mean + 2 * deviation, color=INERTIAL, alpha=0.1, linewidth=0, label="2 sigma")
    axes.set_ylabel("density")
