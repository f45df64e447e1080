"""Picture of chains: traces, and ranks, which are even where chains agree (Vehtari et al. 2021)."""

from typing import Any

import numpy as np

from motes.mcmc.chains import Chains
from motes.plotting.figures import COLORS, WORDS, new_figure, tidy

MOST, BINS = 10, 20
"""Quantities drawn at most; bins of the ranks."""


def chains_figure(chains: Chains) -> Any:
    """Draw the trace of each quantity, up to ten of them, and beside it how the ranks of each chain's draws are spread.

    Args:
        chains: drawn by `mo.sample`.
    """
    columns = dict(list(chains.columns().items())[:MOST])
    figure = new_figure(9.0, 1.7 * len(columns) + 0.6)
    grid = figure.add_gridspec(len(columns), 2, width_ratios=(2, 1))
    for row, (name, draws) in enumerate(columns.items()):
        trace, ranks = (figure.add_subplot(grid[row, place]) for place in range(2))
        _trace(trace, name, draws)
        _ranks(ranks, draws)
        for axes in (trace, ranks):
            tidy(axes)
    trace.set_xlabel("draw")
    ranks.set_xlabel("rank among all draws")
    return figure


def _trace(axes: Any, name: str, draws: np.ndarray) -> None:
    for chain, values in enumerate(draws):
        axes.plot(values, color=COLORS[chain % len(COLORS)], linewidth=0.5, alpha=0.8)
    axes.set_title(name, fontsize=10, **WORDS)


def _ranks(axes: Any, draws: np.ndarray) -> None:
    # equal draws share the middle of their ranks
    _, which, counts = np.unique(draws, return_inverse=True, return_counts=True)
    places = (np.cumsum(counts) - (counts - 1) / 2)[which].reshape(draws.shape)
    edges = np.linspace(0.5, draws.size + 0.5, BINS + 1)
    even = draws.shape[1] / BINS
    for chain, values in enumerate(places):
        axes.stairs(np.histogram(values, edges)[0] / even, edges, color=COLORS[chain % len(COLORS)], linewidth=1.0)
    axes.axhline(1.0, color="0.4", linewidth=0.8, linestyle=(0, (4, 2)))
    axes.set_ylim(bottom=0)
    axes.set_title("ranks of each chain, 1 = even", fontsize=10)
