"""Scans, measurements that are sets of plots: padded with NaN to one length, and with whether there was a scan at all."""

from typing import Any

import jax
import numpy as np

from motes.core import checks
from motes.laws.observed import Observed


def plots(scans: Any) -> Observed:
    """Bring the scans of a run into the form in which a `Cluttered` sensor is given them.

    Args:
        scans: for each step the plots `(m, z)` of its scan, m of any number: an empty scan, `(0, z)` or `[]`, says that nothing was seen.
            None says that there was no scan, which tells nothing. Plots may lie anywhere, also two at one place; where the clutter's law
            has no density they can only be the target's.

    Returns:
        An object with `value`, plots `(t, K, z)` with NaN beyond those of a scan, and `there`, whether there was a scan, `(t,)`.

    Raises:
        MotesError: a scan is no array of plots, plots have different numbers of components, or there is none in any scan.
    """
    if isinstance(scans, Observed):
        return scans
    if not isinstance(scans, (list, tuple)) or not len(scans):
        checks.refuse("plots scans", "a list with an array (plots, z) for each step", "none" if isinstance(scans, (list, tuple))
                      else type(scans).__name__)  # fmt: skip
    found = [None if scan is None else checks.as_numbers(f"plots scan {step}", scan) for step, scan in enumerate(scans)]
    wide = {scan.shape[1] for scan in found if scan is not None and scan.ndim == 2}
    for step, scan in enumerate(found):
        if scan is not None and scan.ndim != 2 and scan.size:
            checks.refuse(f"plots scan {step}", "shape (plots, z)", f"shape {scan.shape}", "One plot is [[range, azimuth]].")
        wrong = None if scan is None else checks.unknown(scan, nan=False)
        if scan is not None and wrong is not None:
            checks.refuse(f"plots scan {step}", "finite numbers", f"{scan[tuple(wrong)]} at index {wrong.tolist()}")
    if len(wide) != 1:
        checks.refuse("plots scans", "plots with one number of components", "none" if not wide else " and ".join(map(str, sorted(wide))),
                      "" if wide else "Write np.zeros((0, z)) for an empty scan.")  # fmt: skip
    most, size = max(1, *(len(scan) for scan in found if scan is not None), 1), wide.pop()
    value = np.full((len(found), most, size), np.nan)
    for step, scan in enumerate(found):
        if scan is not None and scan.size:
            value[step, : len(scan)] = scan
    return Observed(value, np.array([scan is not None for scan in found]))


def with_room(ys: Any, most: int, leaves_out: bool, size: int | None) -> Observed:
    """Return scans with room for so many plots each, those that are there first.

    Args:
        ys: what `plots` gives or takes, or an array `(t, m, z)` with a plot at least at each step.
        most: plots that there is room for.
        leaves_out: whether plots may lack components.
        size: how many components a plot has; None where only plots tell it.

    Raises:
        MotesError: they are no scans, one has more plots, or a plot lacks some of its components.
    """
    ys = ys if isinstance(ys, Observed) else _scans(ys, size)
    if not checks.is_concrete(ys):
        checks.shape("ys", ys.value, (None, most, None), "(steps, most plots of a scan, z)")
        return ys
    value, there = np.asarray(ys.value), np.asarray(ys.there, bool)
    missing = np.isnan(value)
    seen = np.logical_not(np.all(missing, axis=-1, keepdims=True))[..., 0]
    counts = seen.sum(axis=1)
    if (counts > most).any():
        step = int(np.argmax(counts > most))
        checks.refuse("ys", f"scans of at most {most} plots", f"{counts[step]} in scan {step}", "Say plots= that many.")
    partly = (missing & seen[..., None]).any(axis=-1)
    if partly.any() and not leaves_out:
        step, plot = np.argwhere(partly)[0]
        checks.refuse("ys", "whole plots (what a component's clutter is without the others is not known)",
                      f"NaN in plot {plot} of scan {step}", "Leave the plot out, or give a clutter law of independent components.")
    if not there.all() and seen[~there].any():
        checks.refuse("ys", "no plots where there was no scan", f"some at step {int(np.argmax(seen.any(axis=1) & ~there))}")
    if value.shape[1] == most:
        return ys
    order = np.argsort(~seen, axis=1, kind="stable")[:, : most]
    room = ((0, 0), (0, most - order.shape[1]), (0, 0))
    return Observed(np.pad(np.take_along_axis(value, order[..., None], axis=1), room, constant_values=np.nan), there)


def _scans(ys: Any, size: int | None) -> Observed:
    """Return scans of a list, or of an array `(t, m, z)` in which no scan is empty, or all are, `(t, 0)`."""
    if type(ys) in (list, tuple):
        return plots(ys if size is None else [np.zeros((0, size)) if _is_blank(scan) else scan for scan in ys])
    wanted = "scans, as mo.plots makes them of a list of arrays (plots, z)"
    is_leaf = jax.tree_util.all_leaves([ys])
    array = checks.as_numbers("ys", ys, wanted) if is_leaf else ys
    if is_leaf and size is not None and np.shape(array)[1:] == (0,):
        array = np.zeros((len(array), 0, size))
    if not is_leaf or np.ndim(array) != 3:
        checks.refuse("ys", wanted, f"a {type(array).__name__}" + (f" of shape {np.shape(array)}" if is_leaf else ""))
    if array.shape[1] and checks.is_concrete(array) and np.isnan(np.asarray(array)).all(axis=(1, 2)).any():
        row = int(np.argmax(np.isnan(np.asarray(array)).all(axis=(1, 2))))
        checks.refuse("ys", wanted, f"NaN alone in row {row}", "mo.plots tells an empty scan, [], from none, None.")
    # whole numbers have no NaN for the plots that are not there
    return Observed(array.astype(np.result_type(array, np.float32)), np.ones(array.shape[0], bool))


def _is_blank(scan: Any) -> bool:
    """Tell `[]`, which does not say how many components a plot has."""
    return len(scan) == 0 if isinstance(scan, (list, tuple)) else isinstance(scan, np.ndarray) and scan.shape == (0,)
