"""Units of plots, by what makes a track of them."""

import numpy as np

from motes.applications.plausible import mend, set_to
from motes.applications.target_tracking.beginning import SCANS, begins
from motes.applications.target_tracking.settings import Radar
from motes.io.dialect import TableFile
from motes.io.units import UNITS, as_toml

LOOKED_AT = 40
"""Scans at the start that are looked at."""
MAY_BE = (
    {"azimuth": "rad"}, {"range": "km"}, {"range": "nmi"}, {"range": "ft"}, {"range_rate": "kn"}, {"range_rate": "km/h"}, {"time": "ms"},
    {"range": "nmi", "range_rate": "kn"}, {"range": "km", "range_rate": "km/h"}, {"range": "km", "azimuth": "rad"},
)  # fmt: skip
"""Units that columns may be in."""


def check_units(data: TableFile, times: np.ndarray, scans: list[np.ndarray], radar: Radar) -> None:
    """Refuse plots with which no track begins as they are said to be, and one does in other units.

    Args:
        data: the user's table.
        times: of the scans.
        scans: plots of each: range, azimuth from east, range rate.
        radar: its accuracy.

    Raises:
        FileError: they are in other units, with the line of TOML that says so.
    """
    times, scans = times[:LOOKED_AT], scans[:LOOKED_AT]
    if len(scans) < SCANS or begins(times, scans, radar) is not None:
        return
    for units in MAY_BE:
        if units.keys() & data.units.keys():
            continue
        read = {name: UNITS[unit].factor for name, unit in units.items()}
        if begins(read.get("time", 1.0) * times, [_read(plots, read) for plots in scans], radar) is not None:
            told = " and ".join(f"{name} in {unit}" for name, unit in units.items())
            mend(data.file[-160:], "plots on a line that an aircraft could fly", f"some only with {told}", "Are they so",
                 set_to(as_toml({**data.units, **units})))  # fmt: skip


def _read(plots: np.ndarray, units: dict[str, float]) -> np.ndarray:
    """Return plots in other units than they are said to be in."""
    distance, azimuth, rate = plots.T
    if "azimuth" in units:
        azimuth = np.pi / 2 - np.degrees(np.pi / 2 - azimuth)
        azimuth = (azimuth + np.pi) % (2 * np.pi) - np.pi
    return np.stack([units.get("range", 1.0) * distance, azimuth, units.get("range_rate", 1.0) * rate], axis=1)
