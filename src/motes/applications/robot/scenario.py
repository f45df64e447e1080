"""The recorded run as a job for a filter: one line of time for odometry and ranges, the numbers of the model, and the score."""

import os
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.applications.robot.fix import LOOK, located
from motes.applications.robot.kidnapping import TRUST, carried, found_after
from motes.applications.robot.model import DriveNoise, Step, range_only_model
from motes.core import checks
from motes.core.findings import Diagnosis, Finding
from motes.core.record import record
from motes.diagnostics.diagnose import diagnose
from motes.filters.history import History
from motes.io.recordings import RangeOnlyRecording, read_plaza
from motes.laws.gaussian import Gaussian
from motes.models.state_space import StateSpaceModel

RANGE_SD = 0.54
START_SD = (0.5, 0.5, 0.1, 0.002, 0.1, 0.3)
"""Standard deviations of the states at the start: m, m, rad, rad/s, a share, m (0.3 m is a nanosecond of delay in the radios)."""
STANDING = 0.1
"""A robot slower than this, in meters per second, has no course and counts as standing."""
SMOOTHING = 2.2
"""Seconds over which the course of the drifting path is averaged."""
ALIGNED = 5.0
"""Meters driven over which the heading at a known start is taken from the course."""
SETTLING = 120.0
"""Seconds after an unknown start that are not scored."""
ANY_HEADING = 3.0
"""Radians: so wide a Gaussian is nearly even around the circle."""
WIDE_JITTER = 0.1
"""Meters per square root of a second, until the place of an unknown start is found."""
WANDERING = DriveNoise(slip=0.1, jitter=0.1, heading=0.01, turn=0.03, scale=1e-3)
"""Of particles that carry all six states, and may be drawn anew."""
UNLIKELY = 5.0
"""A scale that is off by so many standard deviations of its prior is no scale of these radios."""


@record
class Scenario:
    """What a filter is given, and what its answer is held against.

    The filter's steps are all times at which something was measured, odometry or range. Times are in seconds since the start.

    Attributes:
        model: the model.
        ys: ranges `(t, b)`, one column per beacon, meters; NaN where none came at that time.
        inputs: what the odometry says of each step, fields `(t,)`; the first step has no length.
        times: `(t,)`.
        scored: steps `(s,)` at which the truth is known: those of the odometry.
        truth: x, y, heading there, `(s, 3)`.
        dead_reckoning: x, y by odometry alone there, `(s, 2)`.
        beacons: places of the beacons, `(b, 2)`.
        counted: whether a scored step counts, `(s,)`; those just after an unknown start, and from a kidnapping on, do not.
        kidnapped: the scored step at which the robot is elsewhere; 0 where it is never carried.
    """

    model: StateSpaceModel
    ys: np.ndarray
    inputs: Step
    times: np.ndarray
    scored: np.ndarray
    truth: np.ndarray
    dead_reckoning: np.ndarray
    beacons: np.ndarray
    counted: np.ndarray
    kidnapped: int = 0


class Score(NamedTuple):
    """How good a run was.

    Attributes:
        rms: root mean square of the distance from the true position over all steps that count, meters.
        worst: largest such distance, meters.
        final: the distance at the end, meters.
        scale: estimate of the scale error at the end, a share.
        scale_sd: standard deviation that the filter gives it.
    """

    rms: jax.Array
    worst: jax.Array
    final: jax.Array
    scale: jax.Array
    scale_sd: jax.Array


def loaded(path: str | os.PathLike[str], odometry: str = "recorded", outliers: float = 0.0, start: str = "known") -> Scenario:
    """Read a recording and make it a job.

    Args:
        path: MATLAB file of the Plaza form.
        odometry: "recorded" takes distance and turn of each step from the file, where turns are those of the true heading; "drifting" takes
            the turns from the course of the file's drifting path, which loses about 20 m on its own.
        outliers: share of ranges that may be far off; 0 for ranges with Gaussian errors.
        start: "known": the place is that of the truth, the heading the course of the first meters (the file's own column of headings is
            not used: in some recordings it looks backward); "unknown": the place is sought by the first ranges, the heading is any.

    Raises:
        FileError: the file cannot be used.
        MotesError: a setting is none of these.
    """
    return of_recording(read_plaza(path), odometry, outliers, start)


def of_recording(
    recording: RangeOnlyRecording, odometry: str = "recorded", outliers: float = 0.0, start: str = "known", kidnap: float = 0.0
) -> Scenario:
    """Make a recording a job; see `loaded`. With `kidnap` the robot is carried elsewhere after so many seconds."""
    checks.option("odometry", odometry, ("recorded", "drifting"))
    turns = recording.odometry[:, 2] if odometry == "recorded" else drifting_turns(recording)
    return scenario(recording, turns, outliers, start, kidnap)


def scenario(
    recording: RangeOnlyRecording, turns: np.ndarray, outliers: float = 0.0, start: str = "known", kidnap: float = 0.0
) -> Scenario:
    """Make a job of a recording with the given turns `(t - 1,)` of the odometry's steps, radians; the rest as for `of_recording`."""
    checks.option("start", start, ("known", "unknown"))
    kidnapped = 0
    if kidnap:
        kidnapped = int(np.searchsorted(recording.truth[:, 0], kidnap, "right"))
        recording, turns = carried(recording, turns, kidnap)
    times, scored, ys = time_line(recording)
    steps = recording.truth[:, 0]
    forward = recording.odometry[:, 1]
    inputs = Step(
        dt=_floats(np.diff(times, prepend=times[0])),
        forward=_floats(_shared_out(times, steps, forward)),
        turn=_floats(_shared_out(times, steps, turns)),
    )
    # hundreds of ranges to a robot that stands would leave a handful of headings: they are left out, or spent on the place of the start
    begin = steps[first_motion(steps, forward)]
    if start == "known":
        place = np.array([*recording.truth[0, 1:3], start_heading(recording, turns)])
        deviations, noise = np.array(START_SD), DriveNoise()
    else:
        begin = max(begin, steps[0] + LOOK)
        driven = float(np.abs(forward[steps[:-1] < begin]).sum())
        place, spread = located(recording, begin, driven)
        deviations, noise = np.array([*spread, *START_SD[2:]]), DriveNoise(jitter=WIDE_JITTER)
        deviations[2] = ANY_HEADING
    extra = [] if outliers == 0 else [1.0]
    if kidnap:
        noise = WANDERING
    initial = Gaussian(_floats([*place, 0, 0, 0, *(0 * one for one in extra)]), _floats(np.diag([*np.square(deviations), *extra])))
    model = range_only_model(_floats(recording.beacons[:, 1:3]), initial, RANGE_SD * (TRUST if kidnap else 1.0), noise, outliers)
    ys = np.where((times > begin)[:, None], ys, np.nan)
    counted = np.full(len(scored), True) if start == "known" else steps > steps[0] + min(begin + SETTLING, 0.5 * (steps[-1] - steps[0]))
    if kidnap:
        counted &= np.arange(len(scored)) < kidnapped
    path = dead_reckoning(np.array([*recording.truth[0, 1:3], start_heading(recording, turns)]), forward, turns)
    return Scenario(model, ys, inputs, times, scored, recording.truth[:, 1:4], path, recording.beacons[:, 1:3], counted, kidnapped)


def time_line(recording: RangeOnlyRecording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Merge odometry and ranges into one sequence of steps; ranges of one instant share a step unless they are to the same beacon.

    Returns:
        Times `(t,)`, the step of each row of truth `(s,)`, and the ranges `(t, b)`, NaN where there is none.
    """
    column = np.argmax(recording.ranges[:, 1, None] == recording.beacons[None, :, 0], axis=1)
    instants = np.concatenate([recording.truth[:, 0], recording.ranges[:, 0]])
    repeat = np.concatenate([np.zeros(len(recording.truth)), _repeats(recording.ranges[:, 0], column)])
    keys, step = np.unique(np.stack([instants, repeat], axis=1), axis=0, return_inverse=True)
    scored, measured = np.split(step, [len(recording.truth)])
    ys = np.full((len(keys), len(recording.beacons)), np.nan)
    ys[measured, column] = recording.ranges[:, 2]
    return keys[:, 0], scored, ys


def _repeats(times: np.ndarray, column: np.ndarray) -> np.ndarray:
    """For each range, how many ranges to the same beacon came before it at the same instant."""
    order = np.lexsort((column, times))
    new = np.ones(len(order), bool)
    new[1:] = (np.diff(times[order]) != 0) | (np.diff(column[order]) != 0)
    place = np.arange(len(order))
    counted = np.empty(len(order))
    counted[order] = place - np.maximum.accumulate(np.where(new, place, 0))
    return counted


def _shared_out(times: np.ndarray, ends: np.ndarray, amounts: np.ndarray) -> np.ndarray:
    """Share amounts `(s - 1,)` between successive ends `(s,)` out over finer times `(t,)`, in proportion to time."""
    total = np.interp(times, ends, np.concatenate([[0.0], np.cumsum(amounts)]))
    return np.diff(total, prepend=0.0)


def first_motion(times: np.ndarray, forward: np.ndarray) -> int:
    """Return the first step of the odometry `(s - 1,)` in which the robot moves, given the times `(s,)` at the ends of steps."""
    return int(np.argmax(np.abs(forward) > STANDING * np.diff(times)))


def start_heading(recording: RangeOnlyRecording, turns: np.ndarray) -> float:
    """Return the heading at the start by the course: that which lays the odometry of the first meters on the true path."""
    forward = recording.odometry[:, 1]
    within = np.cumsum(np.abs(forward)) <= ALIGNED
    within[: first_motion(recording.truth[:, 0], forward) + 2] = True
    ahead = dead_reckoning(np.zeros(3), forward, turns)[1:][within]
    true = (recording.truth[1:, 1:3] - recording.truth[0, 1:3])[within]
    return float(np.angle(np.sum(np.conj(ahead @ [1, 1j]) * (true @ [1, 1j]))))


def drifting_turns(recording: RangeOnlyRecording) -> np.ndarray:
    """Return the turn `(t - 1,)` of each step by the course of the drifting path, smoothed, and interpolated while the robot stands.

    Raises:
        MotesError: the robot never moves.
    """
    steps, dt = np.diff(recording.drifting_path, axis=0), np.diff(recording.truth[:, 0])
    moving = np.hypot(steps[:, 0], steps[:, 1]) > STANDING * dt
    if not moving.any():
        checks.refuse("drifting path", f"a robot faster than {STANDING} m/s", "one that stands")
    course = np.unwrap(np.arctan2(steps[moving, 1], steps[moving, 0]))
    course = np.interp(np.arange(len(steps)), np.flatnonzero(moving), course)
    width = 1 + 2 * int(SMOOTHING / 2 / np.median(dt) + 0.5)
    course = np.convolve(np.pad(course, width // 2, mode="edge"), np.full(width, 1 / width), "valid")
    # the course of a step is the heading at its middle; headings at its ends are means of neighbors
    padded = np.pad(course, 1, mode="edge")
    return np.diff((padded[1:] + padded[:-1]) / 2)


def dead_reckoning(start: np.ndarray, forward: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Return the path `(s, 2)` by odometry `(s - 1,)` alone, from a start (x, y, heading)."""
    course = start[2] + np.cumsum(turns) - turns / 2
    steps = forward[:, None] * np.stack([np.cos(course), np.sin(course)], axis=1)
    return start[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def moves(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distance forward and turn, each `(s - 1,)`, between poses `(s, 3)` (x, y, heading): what `dead_reckoning` undoes."""
    steps = np.diff(poses, axis=0)
    turns = np.angle(np.exp(1j * steps[:, 2]))
    course = poses[:-1, 2] + turns / 2
    return steps[:, 0] * np.cos(course) + steps[:, 1] * np.sin(course), turns


def errors(history: History, scenario: Scenario) -> jax.Array:
    """Distance of the estimated from the true position at the scored steps, `(s,)`, meters."""
    apart = history.mean[scenario.scored, :2] - scenario.truth[:, :2]
    return jnp.hypot(apart[:, 0], apart[:, 1])


def score(history: History, scenario: Scenario) -> Score:
    """Judge a whole run; needs means and covariances. Pure: it can be jitted and vmapped together with the run.

    Raises:
        MotesError: the history does not cover the scenario.
    """
    steps = len(scenario.times)
    if history.mean.shape[0] != steps:
        checks.refuse("history", f"all {steps} steps of the scenario", f"{history.mean.shape[0]} steps", "Join the chunks first.")
    error, counted = errors(history, scenario), scenario.counted
    scale = scenario.model.index("scale")
    return Score(
        rms=jnp.sqrt(jnp.sum(jnp.where(counted, error**2, 0)) / jnp.sum(counted)),
        worst=jnp.max(jnp.where(counted, error, 0)),
        final=error[-1],
        scale=history.mean[-1, scale],
        scale_sd=jnp.sqrt(history.cov[-1, scale, scale]),
    )


def found_again(history: History, scenario: Scenario) -> tuple[float, float]:
    """Return the seconds from the kidnapping until the robot is found, and the root mean square error, meters, from then on."""
    times, error = scenario.times[scenario.scored], np.asarray(errors(history, scenario))
    seconds = found_after(times, error, scenario.kidnapped)
    later = times >= times[scenario.kidnapped] + seconds
    return seconds, float(np.sqrt(np.mean(error[later] ** 2))) if later.any() else np.inf


def diagnosed(history: History, scenario: Scenario) -> Diagnosis:
    """Say in words whether to trust a run: what `diagnose` finds, and a scale or an offset that their prior does not allow."""
    found = list(diagnose(history).findings)
    prior, spread = np.asarray(scenario.model.initial.mean()), np.sqrt(np.diag(np.asarray(scenario.model.initial.cov())))
    for name in ("scale", "offset", "gyro_bias"):
        place = scenario.model.index(name)
        off = float(np.abs(np.asarray(history.mean)[:, place] - prior[place]).max() / spread[place])
        if not off <= UNLIKELY:
            text = f"the {name.replace('_', ' ')} was estimated {off:.1f} standard deviations of its prior away from it."
            found.append(Finding("beyond the prior", text, "The track is lost, or the start is not where it is said to be.", True))
    return Diagnosis.of(found)


def _floats(values: np.ndarray | list[float]) -> jax.Array:
    return jnp.asarray(values, jnp.result_type(float))
