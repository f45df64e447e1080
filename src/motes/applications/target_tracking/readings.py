"""Units of plots, by what ranges and range rates say of one another, and by where plots come from."""

from typing import NamedTuple

import numpy as np

from motes.applications.plausible import WHOLE, mend, set_to
from motes.io.dialect import TableFile
from motes.io.named_tables import own_unit
from motes.io.units import UNITS, as_toml

LOOKED_AT, APART = 60, 4
"""Scans at the start that are looked at, and how many are between two that are held against one another."""
ALIKE, ABOUT = 0.2, 0.15
"""Radians of azimuth, and share of a range rate, by which two plots of one aircraft differ at most."""
NEAR = 1.12
"""Factor by which what ranges say of a speed may miss the range rates."""
MANY, MORE = 8, 4
"""So many pairs of plots at least agree in other units, and so many times as many as in those that are told."""
CLUTTER, TURN = 3.0, 2 * np.pi
"""Plots a scan from which on they come from all around; a whole turn in radians, which is a narrow sector in degrees."""


class Reading(NamedTuple):
    """Units that columns may be in, and how many times the speed by range rates that by ranges then seems to be."""

    units: dict[str, str]
    ratio: float


def check_units(data: TableFile, times: np.ndarray, scans: list[np.ndarray]) -> None:
    """Refuse plots whose ranges contradict their range rates, where other units make them agree; and azimuths in radians.

    Args:
        data: the user's table.
        times: of the scans.
        scans: plots of each: range, azimuth from east, range rate.

    Raises:
        FileError: they are in other units, with the line of TOML that says so.
    """
    times, scans = times[:LOOKED_AT], scans[:LOOKED_AT]
    source, told = data.file[-160:], {name: unit for name in ("time", "range", "azimuth", "range_rate") if (unit := own_unit(data, name))}
    plots = np.concatenate([np.zeros((0, 3)), *scans])
    bearings = np.degrees(np.pi / 2 - plots[:, 1]) % 360
    if "azimuth" not in told and len(plots) >= CLUTTER * max(len(scans), 10) and bearings.max() <= TURN and np.ptp(bearings) > TURN / 2:
        mend(source, "plots from all around in degrees", f"{len(plots)} of them from 0 to {bearings.max():.2f}", "Radians",
             set_to(as_toml(told | {"azimuth": "rad"})))  # fmt: skip
    ratios = _ratios(times, scans)

    def agreeing(ratio: float) -> int:
        return int((np.abs(np.log(ratios / ratio)) < np.log(NEAR)).sum())

    readings = [one for one in _readings(times) if not one.units.keys() & told.keys()]
    if not readings:
        return
    best = max(readings, key=lambda one: agreeing(one.ratio))
    if agreeing(best.ratio) >= max(MANY, MORE * agreeing(1.0)):
        meant = " and ".join(f"{name} in {unit}" for name, unit in best.units.items())
        mend(source, "ranges that change as range rates say", f"{best.ratio:.3g} times as fast", f"Perhaps {meant}",
             set_to(as_toml(told | best.units)))  # fmt: skip


def _ratios(times: np.ndarray, scans: list[np.ndarray]) -> np.ndarray:
    """Return the speed by ranges over that by range rates, of pairs of plots that may be of one aircraft; those below 0 are left out."""
    found = [np.zeros(0)]
    for before, after, apart in zip(scans, scans[APART:], times[APART:] - times[:-APART], strict=False):
        one, two = before[:, None], after[None]
        turned = np.abs((one[..., 1] - two[..., 1] + np.pi) % (2 * np.pi) - np.pi)
        mean, off = (one[..., 2] + two[..., 2]) / 2, np.abs(one[..., 2] - two[..., 2])
        speed = (two[..., 0] - one[..., 0]) / apart
        alike = (turned < ALIKE) & (off < ABOUT * np.abs(mean)) & (speed * mean > 0)
        found.append((speed / np.where(alike, mean, 1.0))[alike])
    return np.concatenate(found)


def _readings(times: np.ndarray) -> list[Reading]:
    steps = np.diff(times)
    whole = steps.size > 0 and np.median(steps) >= WHOLE and (steps == np.round(steps)).all()
    units = [{"time": "ms"}] if whole else [{"range": "km"}]
    units += [{"range_rate": "kn"}, {"range_rate": "km/h"}, {"range": "nmi"}, {"range": "ft"}, {"range": "nmi", "range_rate": "kn"}]

    def ratio(one: dict[str, str]) -> float:
        factors = {name: UNITS[unit].factor for name, unit in one.items()}
        return factors.get("range_rate", 1.0) * factors.get("time", 1.0) / factors.get("range", 1.0)

    return [Reading(one, ratio(one)) for one in units]
