"""Recordings of a ground robot that measures ranges to beacons, from MATLAB files of the form of the Plaza data sets.

Source of the form: Djugash, Hamner, Roth, "Navigating with ranging radios: five data sets with ground truth", J. Field Robotics 2009.
"""

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.io import savemat

from motes.core.checks import refuse
from motes.core.record import record, static
from motes.io.archive import whole_file
from motes.io.files import label, reject
from motes.io.matlab import read_matrices
from motes.io.units import converted

COLUMNS = {"GT": 4, "DR": 3, "DRp": 4, "TD": 4, "TL": 3}
QUANTITIES: dict[str, tuple[str, dict[str, list[int]]]] = {
    "time": ("s", {"GT": [0], "DR": [0], "DRp": [0], "TD": [0]}), "place": ("m", {"GT": [1, 2], "DRp": [1, 2], "TL": [1, 2]}),
    "heading": ("rad", {"GT": [3], "DRp": [3]}), "forward": ("m", {"DR": [1]}), "turn": ("rad", {"DR": [2]}), "range": ("m", {"TD": [3]}),
}  # fmt: skip
"""What a file holds: its unit, and in which columns of which matrix it is."""


@record
class RangeOnlyRecording:
    """What a robot measured, and where it was. All arrays are float64, in seconds, meters and radians; time 0 is the first row of truth.

    Attributes:
        truth: `(t, 4)`: time, x, y, heading from east, counterclockwise.
        odometry: `(t - 1, 3)`: time at the end of the step, distance forward, turn; step i leads from row i of truth to row i + 1.
        drifting_path: `(t, 2)`: x, y by another odometry, whose heading drifts, at the times of truth.
        ranges: `(r, 3)`: time, id of the beacon, range; in order of time.
        beacons: `(b, 3)`: id, x, y, surveyed.
        source: name of the file.
        start: time of the first row of truth in the file.
    """

    truth: np.ndarray
    odometry: np.ndarray
    drifting_path: np.ndarray
    ranges: np.ndarray
    beacons: np.ndarray
    source: str = static(default="recording")
    start: float = static(default=0.0)


def read_plaza(path: str | os.PathLike[str], units: Mapping[str, str] | None = None) -> RangeOnlyRecording:
    """Read a recording from a MATLAB 5 file with the variables GT, DR, DRp, TD and TL.

    Ranges are sorted by time (the receiver's log goes back in time at places); the sender in the second column of TD is left out.

    Args:
        path: the file.
        units: of what is in others than seconds, meters and radians, by the names in `QUANTITIES`.

    Raises:
        MotesError: there is no such quantity or unit.
        FileError: the file is damaged or no MATLAB 5 file, or a variable is missing, has another shape, holds something other than finite
            numbers, or does not fit the others; the message names the variable.
    """
    found = read_matrices(path, COLUMNS)
    _convert(found, units or {})
    truth, odometry, path_rows, ranges, beacons = (found[name] for name in COLUMNS)
    _check_times(path, truth, odometry, path_rows)
    _check_ranges(path, truth, ranges, beacons)
    begin = truth[0, 0]
    for rows in (truth, odometry, ranges):
        rows[:, 0] -= begin
    ranges = ranges[np.argsort(ranges[:, 0], kind="stable")][:, [0, 2, 3]]
    return RangeOnlyRecording(truth, odometry, path_rows[:, 1:3], ranges, beacons, label(path), float(begin))


def _convert(found: dict[str, np.ndarray], units: Mapping[str, str]) -> None:
    """Convert matrices in place."""
    for name, unit in units.items():
        if name not in QUANTITIES:
            refuse("units", f"units of {', '.join(QUANTITIES)}", repr(name[:60]))
        expected, places = QUANTITIES[name]
        for matrix, columns in places.items():
            found[matrix][:, columns] = converted(f"units {name}", found[matrix][:, columns], unit, expected)


def _check_times(path: str | os.PathLike[str], truth: np.ndarray, odometry: np.ndarray, path_rows: np.ndarray) -> None:
    if len(truth) < 2 or len(odometry) != len(truth) - 1 or len(path_rows) != len(truth):
        reject(path, "one row less in DR than in GT and DRp", f"{len(odometry)}, {len(truth)} and {len(path_rows)} rows")
    if (np.diff(truth[:, 0]) <= 0).any():
        reject(path, "times that increase in GT", f"a step back in row {int(np.argmax(np.diff(truth[:, 0]) <= 0)) + 2}")
    apart = np.abs(odometry[:, 0] - truth[1:, 0]) > 1e-3
    if apart.any():
        reject(path, "times in DR equal to those in GT from its second row on", f"others in row {int(np.argmax(apart)) + 1}")


def _check_ranges(path: str | os.PathLike[str], truth: np.ndarray, ranges: np.ndarray, beacons: np.ndarray) -> None:
    ids = beacons[:, 0]
    if len(np.unique(ids)) != len(ids):
        reject(path, "different beacon ids in TL", ids.tolist())
    bad = ~np.isin(ranges[:, 2], ids)
    if bad.any():
        reject(path, f"beacon ids in TD among {ids.tolist()}", f"{ranges[np.argmax(bad), 2]} in row {int(np.argmax(bad)) + 1}")
    bad = ranges[:, 3] < 0
    if bad.any():
        reject(path, "ranges in TD that are not negative", f"{ranges[np.argmax(bad), 3]} in row {int(np.argmax(bad)) + 1}")
    bad = (ranges[:, 0] < truth[0, 0]) | (ranges[:, 0] > truth[-1, 0])
    if bad.any():
        reject(path, "times in TD within those of GT", f"{ranges[np.argmax(bad), 0]} in row {int(np.argmax(bad)) + 1}")


def write_plaza(path: str | os.PathLike[str], recording: RangeOnlyRecording) -> None:
    """Write a recording as `read_plaza` reads it, whole or not at all."""
    drifting = np.column_stack([recording.truth[:, 0], recording.drifting_path, recording.truth[:, 3]])
    times, ids, ranges = recording.ranges.T
    log = np.column_stack([times, np.zeros(len(times)), ids, ranges])
    matrices = {"GT": recording.truth, "DR": recording.odometry, "DRp": drifting, "TD": log, "TL": recording.beacons}
    with whole_file(Path(path)) as file:
        savemat(file, matrices, do_compression=True)
