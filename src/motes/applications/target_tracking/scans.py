"""Scans and true states of the user's own, and recorded flights along which plots are drawn."""

from pathlib import Path

import numpy as np

from motes.applications.aircraft import scenario
from motes.applications.plausible import mend, set_to
from motes.applications.target_tracking.settings import Settings
from motes.applications.target_tracking.world import World, seen
from motes.core import checks
from motes.io.clocks import Clock
from motes.io.columns import Columns
from motes.io.dialect import TableFile
from motes.io.files import label, look
from motes.io.named_tables import named_columns, own_unit, read_named
from motes.io.result_table import Table
from motes.io.units import as_toml

PLOT = {"time": "s", "range": "m", "azimuth": "deg", "range_rate": "m/s"}
STATE = {"time": "s", "east": "m", "north": "m", "v_east": "m/s", "v_north": "m/s"}
"""Columns, and the unit of each."""
TARGET = "target"
"""Column of the truth that tells targets apart."""
FEWEST, FAR_APART = 4, 100
"""So many steps between scans at least that are so many times their period, by whole numbers, are in milliseconds."""
LONGEST = 10_000
"""Scans that a file is filled up to at most."""
CATEGORIES, BLANK = (1, 20, 21, 34, 48, 62), 9
"""First bytes of blocks of ASTERIX; below the second number no byte of a text is."""
CAPTURES = (b"\xd4\xc3\xb2\xa1", b"\xa1\xb2\xc3\xd4", b"\x4d\x3c\xb2\xa1", b"\xa1\xb2\x3c\x4d", b"\x0a\x0d\x0d\x0a")
"""First bytes of captures of packets (pcap, pcapng)."""


def read_scans(data: TableFile, period: float) -> tuple[np.ndarray, list[np.ndarray], Clock]:
    """Return times `(t,)` of scans, in seconds of the file, the plots of each, and how times are written.

    Plots are `(m, 3)`: range, azimuth from east (radians), range rate.

    Args:
        data: see `Settings.data`.
        period: see `Settings.period`.

    Raises:
        FileError: the file cannot be used; the message names column and row.
        MotesError: the period is negative.
    """
    if not period >= 0:
        checks.refuse("period", "a number of seconds, 0 or more", period)
    table = read_named(data.file, PLOT, data, beside=(*STATE, TARGET))
    start, times = table.times("time")
    rows = np.stack([table["range"], np.pi / 2 - np.radians(table["azimuth"]), table["range_rate"]], axis=1)
    missing = np.isnan(rows)
    count = missing.sum(axis=1)
    partly = (count > 0) & (count < missing.shape[1])
    _refuse_rows(table, partly, "range", "range, azimuth and range_rate, or none of them", "Leave the plot out.")
    _refuse_rows(table, rows[:, 0] < 0, "range", "meters, not below 0", "")
    rows[:, 1] = (rows[:, 1] + np.pi) % (2 * np.pi) - np.pi
    begins = np.flatnonzero(np.diff(times, prepend=-np.inf) > 0)
    if not own_unit(data, "time") and not table.clocks["time"].format:
        _check_seconds(table.source, times[begins], period)
    found: list[tuple[float, np.ndarray]] = []
    for block in np.split(np.arange(len(times)), begins[1:]):
        now = float(times[block[0]])
        gaps = int(round((now - found[-1][0]) / period)) - 1 if found and period else 0
        if len(found) + gaps > LONGEST:
            checks.refuse(f"{table.source}: column 'time'", f"at most {LONGEST} scans", f"a gap of {gaps} before {table.place(block[0])}",
                          "Set the period, or 0 where the file has all scans.", checks.FileError)  # fmt: skip
        before = found[-1][0] if found else now
        found += [(before + (now - before) * (gap + 1) / (gaps + 1), np.zeros((0, 3))) for gap in range(gaps)]
        found.append((now, rows[block][count[block] == 0]))
    return start + np.array([time for time, _ in found]), [plots for _, plots in found], table.clocks["time"]


def _check_seconds(source: str, times: np.ndarray, period: float) -> None:
    """Refuse times of scans in milliseconds: whole numbers, so many times the period apart.

    Raises:
        FileError: they are.
    """
    steps = np.diff(times)
    if period and len(steps) >= FEWEST and (steps == np.round(steps)).all() and np.median(steps) > FAR_APART * period:
        mend(source, f"scans {period:g} s apart", f"{np.median(steps):g} s at the median", "Milliseconds", set_to(as_toml({"time": "ms"})))


def read_truth(settings: Settings, times: np.ndarray) -> tuple[tuple[str, ...], np.ndarray]:
    """Return names of m targets and their true states `(t, m, 4)` at some times, between those of a file (see `Settings.truth`).

    States are NaN beyond the times of a target in the file. Without the column `target` there is one, whose name is "".

    Raises:
        FileError: the file cannot be used, or the times of a target do not grow.
    """
    found = {}
    for name, table in read_named(settings.truth, STATE, settings.data, (TARGET,), beside=tuple(PLOT)).by(TARGET).items():
        start, seconds = table.times("time", repeats=False)
        found[name] = _interpolated(times - start, seconds, np.stack([table[column] for column in list(STATE)[1:]], axis=1))
    return tuple(found), np.stack(list(found.values()), axis=1)


def is_recording(data: TableFile) -> bool:
    """Tell a recording of ADS-B reports from a file of plots, by its columns.

    Raises:
        FileError: the file cannot be read.
    """
    _refuse_asterix(data.file)
    return {"latitude", "longitude"} <= set(named_columns(data.file, data))


def flown_by(settings: Settings, seed: int) -> World:
    """Draw the plots of a radar along the flights of a recording; a target is there while it is within reach of the radar.

    Args:
        settings: of the application: the recording, radar, its site, and which part of the recording.
        seed: of the plots.

    Raises:
        FileError: the recording cannot be used.
        MotesError: a setting cannot be used.
    """
    checks.above_zero("period", settings.period)
    checks.positive_integer("scans", settings.scans)
    times = settings.period * np.arange(min(settings.scans, LONGEST))
    site, data = (settings.site.east, settings.site.north), settings.data
    paths = scenario.read_paths(data.file, settings.begin, float(times[-1]) + settings.period, site, data)
    states = np.stack([_interpolated(times, path.times, path.states) for path in paths.values()], axis=1)
    states[np.hypot(states[..., 0], states[..., 1]) > settings.radar.farthest] = np.nan
    near = np.asarray(~np.isnan(states).all(axis=(0, 2)))
    if not near.any():
        checks.refuse("site", f"a place within {settings.radar.farthest:g} m of a flight", f"{len(paths)} flights further off",
                      "Set site.east, site.north or radar.farthest.")  # fmt: skip
    names = tuple(name for name, kept in zip(paths, near, strict=True) if kept)
    first, plots = next(iter(paths.values())), seen(np.random.default_rng(seed), states[:, near], settings.radar)
    return World(times, names, states[:, near], plots, first.start, first.clock)


def _interpolated(times: np.ndarray, known: np.ndarray, states: np.ndarray) -> np.ndarray:
    """States `(t, 4)` at some times, between those known, `(k, 4)`; NaN beyond them."""
    return np.stack([np.interp(times, known, column, np.nan, np.nan) for column in states.T], axis=1)


def written_scans(path: Path, times: np.ndarray, scans: list[np.ndarray]) -> None:
    """Write scans as `read_scans` reads them."""
    rows = []
    for time, plots in zip(times, scans, strict=True):
        known = [(float(time), float(r), float(np.degrees(np.pi / 2 - a) % 360), float(v)) for r, a, v in plots]
        rows += known or [(float(time), None, None, None)]
    Table(tuple(PLOT), tuple(rows)).save(path)


def written_truth(path: Path, world: World) -> None:
    """Write true states as `read_truth` reads them; the column of targets is left out where there is one."""
    several = len(world.names) > 1
    rows = [(float(time), *state, *[name] * several)
            for name, states in zip(world.names, np.moveaxis(world.states, 1, 0), strict=True)
            for time, state in zip(world.times, states.tolist(), strict=True) if not np.isnan(state).any()]  # fmt: skip
    Table((*STATE, *[TARGET] * several), tuple(rows)).save(path)


def _refuse_asterix(file: str) -> None:
    """Refuse plots as radars send them, by the first bytes: a data block of ASTERIX (category, length), or a capture of packets."""
    _, start = look(file, 4)
    if start in CAPTURES or start[0] in CATEGORIES and len(start) > 2 and start[1] < BLANK:
        checks.refuse(label(file), "a table of plots", "ASTERIX or a capture of packets",
                      "Decode it (such as pip install asterix_decoder, import asterix) and write CSV with the columns time (s), range (m; "
                      "NM times 1852), azimuth (degrees from north) and range_rate (m/s): of category 48 I140, I040 and I120.",
                      checks.FileError)  # fmt: skip


def _refuse_rows(table: Columns, bad: np.ndarray, name: str, expected: str, hint: str) -> None:
    if bad.any():
        row = int(np.argmax(bad))
        given = f"{table[name][row]:g}"
        checks.refuse(f"{table.source}: column {name!r}", f"{expected} in {table.place(row)}", given, hint, checks.FileError)
