"""The tracker as an application: `motes demo notch`, and `motes run`, `motes plan` and `motes study` of its settings."""

import jax.numpy as jnp
import numpy as np

from motes.applications.interface import with_cloud
from motes.applications.target_tracking import scans as reading
from motes.applications.target_tracking.beginning import begun
from motes.applications.target_tracking.model import Tracker
from motes.applications.target_tracking.one import TrackingJob
from motes.applications.target_tracking.readings import check_units
from motes.applications.target_tracking.settings import Settings
from motes.applications.target_tracking.several import SeveralJob
from motes.applications.target_tracking.shared import RadarJob
from motes.applications.target_tracking.world import World, made_up
from motes.core import checks
from motes.filters.jump_markov import JumpMarkovFilter
from motes.filters.particle import ParticleFilter
from motes.laws.cluttered import room_for
from motes.laws.scans import plots

INBOUND = np.array([34e3, 0.0, -200.0, 0.0]), np.diag([300.0, 300.0, 30.0, 30.0]) ** 2
"""Mean and covariance of a track where `motes plan` and `motes study` are asked of several."""


def load(settings: Settings, seed: int) -> RadarJob:
    """Read the plots that the settings name, draw some along a recording, or make flights up; begin the track where there is one.

    Args:
        settings: of the application.
        seed: of what is made up.

    Raises:
        FileError: a file cannot be used.
        MotesError: a setting cannot be used, or no track begins.
    """
    radar = settings.radar
    for name in ("distance", "azimuth", "rate", "edge", "false", "farthest", "fastest"):
        checks.above_zero(f"radar {name}", getattr(radar, name))
    checks.above_zero("radar detection", radar.detection, 1)
    world = _world(settings, seed)
    if world is not None:
        times, names, truth, scans, before, clock = world
    else:
        (times, scans, clock), before = reading.read_scans(settings.data, settings.period), 0.0
        names, truth = reading.read_truth(settings, times) if settings.truth else ((), None)
        check_units(settings.data, times, scans)
    room = max(*(len(scan) + 1 for scan in scans), room_for(radar.false))
    common = {"radar": radar, "world": world, "seed": seed, "counted": ("east", "north"), "start": before + float(times[0]),
              "clock": clock, "data": settings.data}  # fmt: skip
    if settings.targets != 1 or len(names) > 1:
        return SeveralJob(
            model=Tracker(radar, room)(*INBOUND), tracker=Tracker(radar, room),
            ys=plots(scans), inputs={"dt": jnp.asarray(np.diff(times, prepend=times[0]), float)}, truth=truth,
            targets=names, times=times - times[0], filters={"jump_markov": JumpMarkovFilter(n=5)}, **common,
        )  # fmt: skip
    begin = begun(times, scans, radar)
    if begin.scan == len(scans) - 1:
        checks.refuse("data", "scans after those with which a track begins", f"none after {len(scans)}")
    left = slice(begin.scan, None)
    model, unaware = (Tracker(radar, room, knows)(begin.mean, begin.cov).as_state_space() for knows in (True, False))
    dt = np.diff(times[left], prepend=times[begin.scan])
    # the plots that the track begins with are in its first law
    return TrackingJob(
        model=model, unaware=unaware, ys=plots([None, *scans[left][1:]]), inputs={"dt": jnp.asarray(dt, float)},
        truth=None if truth is None else truth[left, 0], times=times[left] - times[0],
        filters={"particle": ParticleFilter(n=2_000)}, keep=with_cloud, **common,
    )  # fmt: skip


def _world(settings: Settings, seed: int) -> World | None:
    """What was flown, where it is made up or recorded; None where there are plots."""
    if not settings.data.file:
        return made_up(seed, settings.scans, settings.period, settings.radar, settings.targets)
    return reading.flown_by(settings, seed) if reading.is_recording(settings.data) else None
