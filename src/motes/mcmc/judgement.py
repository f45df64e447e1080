"""Chains summed up in a table and judged in words.

A serious finding says not to trust the chains: "stuck" (a chain that never moved), "not mixed" (R-hat above 1.01), "few draws" (fewer than
100 effective ones per chain), "invalid" (densities that are no numbers), "never accepted" (a move; a note unless some quantity never
changed). Note: "one chain".
"""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from motes.core.findings import Diagnosis, Finding
from motes.io.result_table import Table
from motes.mcmc import convergence

MIXED = 1.01
FEWEST = 4
"""Draws of a chain that R-hat and effective sizes ask for."""
ENOUGH = 100
"""Effective draws wanted of each chain."""
RARE = 1e-3
"""Share of proposals up to which densities that are no numbers are a matter of rounding."""
COLUMNS = ("quantity", "mean", "sd", "5 %", "95 %", "s.e. of mean", "bulk ESS", "tail ESS", "R-hat")


def summary(columns: Mapping[str, np.ndarray]) -> Table:
    """Return a row for each quantity."""
    rows = []
    for name, draws in columns.items():
        values = np.asarray(draws, np.float64)
        low, high = np.quantile(values, convergence.TAILS)
        summary = (values.mean(), values.std(ddof=1) if values.size > 1 else np.nan, low, high)
        sure = (convergence.standard_error(values), convergence.bulk_ess(values), convergence.tail_ess(values), convergence.r_hat(values))
        rows.append((name, *map(float, summary), *sure))
    return Table(COLUMNS, tuple(rows))


def diagnosis_of(chains: Any) -> Diagnosis:
    """Judge chains; see the head of this file."""
    columns = chains.columns()
    return Diagnosis.of([_invalid(chains), _stuck(chains), _never(chains), _mixed(columns), _few(columns), _alone(chains)])


def at_once(chains: Any) -> list[Finding]:
    """Find what a caller should hear of at once: chains that never moved, many densities that are no numbers."""
    return [finding for finding in (_invalid(chains), _stuck(chains)) if finding is not None and finding.serious]


def _invalid(chains: Any) -> Finding | None:
    counts, tried = (np.asarray(part, np.float64).sum(axis=0) for part in (chains.info.invalid, chains.info.tried))
    if not counts.any():
        return None
    which = ", ".join(f"{move} {count:.0f}" for move, count in zip(chains.moves, counts, strict=True) if count)
    text = f"log_density was NaN or infinite, a trajectory left all bounds or a jump was not undone: {which}; none was accepted."
    advice = "Look for logarithms and roots of negative numbers; give impossible positions -inf."
    return Finding("invalid", text, advice, bool((counts > RARE * tried).any()))


def _stuck(chains: Any) -> Finding | None:
    leaves = [np.asarray(leaf).reshape(*np.shape(leaf)[:2], -1) for leaf in jax.tree.leaves(chains.positions)]
    still = np.all([np.all(leaf == leaf[:, :1], axis=(1, 2)) for leaf in leaves], axis=0)
    if not still.any() or chains.log_density.shape[1] < 2:
        return None
    which = ", ".join(map(str, np.flatnonzero(still)))
    return Finding("stuck", f"chain {which} never moved in {chains.log_density.shape[1]} draws.",
                   "Take smaller steps (Adaptive finds them) or another start.", True)


def _never(chains: Any) -> Finding | None:
    names = [move for move, rate in chains.acceptance.items() if rate < 1e-6]
    if not names:
        return None
    text = f"no proposal of {', '.join(names)} was accepted."
    still = [name for name, draws in chains.columns().items() if draws.size > 1 and np.ptp(draws) == 0]
    also = f" {', '.join(still)} never changed." if still else ""
    return Finding("never accepted", text + also, "Take smaller steps, or leave this move out.", bool(still))


def _mixed(columns: Mapping[str, np.ndarray]) -> Finding | None:
    values = {name: convergence.r_hat(draws) for name, draws in columns.items()}
    worst = max(values, key=lambda name: -1.0 if np.isnan(values[name]) else values[name])
    if not values[worst] > MIXED:
        return None
    return Finding("not mixed", f"chains disagree: R-hat is {values[worst]:.3f} for {worst}, more than {MIXED}.",
                   "Draw more, burn in longer, or look whether there are several modes.", True)


def _few(columns: Mapping[str, np.ndarray]) -> Finding | None:
    chains, count = next(iter(columns.values())).shape
    if count < FEWEST:
        return Finding("few draws", f"{count} draws of each chain tell nothing.", "Draw more.", True)
    sizes = {name: min(convergence.bulk_ess(draws), convergence.tail_ess(draws)) for name, draws in columns.items()}
    known = {name: size for name, size in sizes.items() if not np.isnan(size)}
    if not known:
        return None
    worst = min(known, key=known.__getitem__)
    wanted = ENOUGH * chains
    if known[worst] >= wanted:
        return None
    text = f"{worst} has {known[worst]:.0f} effective draws, fewer than {wanted}."
    return Finding("few draws", text, "Draw more, or use a better kernel.", True)


def _alone(chains: Any) -> Finding | None:
    if chains.log_density.shape[0] > 1:
        return None
    return Finding("one chain", "R-hat of a single chain cannot see modes that it missed.", "Use at least four.", False)
