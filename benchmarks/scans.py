"""Worlds of targets among false plots, the same for all trackers of `tracking.py`, and what is counted of tracks."""

from dataclasses import dataclass

import numpy as np

import motes as mo


@dataclass(frozen=True)
class World:
    """Targets of constant velocity, one scan a second, and a sensor that sees false plots too.

    Attributes:
        name: of the case.
        starts: of each target mean and variances of east, north and their velocities, m and m/s.
        intensity: of the white acceleration, m^2/s^3.
        noise: variances of a plot: range and azimuth where `polar`, else east and north, m^2 and rad^2.
        polar: see there.
        detection: probability that a target gives a plot.
        density: false plots per unit of measurement space.
        region: lowest and highest plot that can be.
        scans: of a run.
        far: mean distance in the last ten scans from which on a target is lost, m.
    """

    name: str
    starts: tuple
    intensity: float
    noise: tuple
    polar: bool
    detection: float
    density: float
    region: tuple
    scans: int
    far: float

    @property
    def rate(self):
        """False plots of a scan, on average."""
        return self.density * float(np.prod(np.subtract(self.region[1], self.region[0])))


def one_target(name, detection, density, distance=2_200.0):
    """A target that passes a radar at a distance; 957 m and half a radian on each side of it are seen."""
    start = ((distance, -500.0, 0.0, 10.0), (400.0, 400.0, 25.0, 25.0))
    region = ((distance - 957, -0.5), (distance + 957, 0.5))
    return World(name, (start,), 1.0, (400.0, 1e-4), True, detection, density, region, 100, 150.0)


def two_targets():
    """Two whose paths cross at a small angle in the middle of the run."""
    starts = tuple(((-400.0, side * 80.0, 10.0, -side * 2.0), (100.0, 100.0, 1.0, 1.0)) for side in (1, -1))
    return World("two crossing", starts, 0.05, (100.0, 100.0), False, 0.9, 10 / 1_200**2, ((-600.0,) * 2, (600.0,) * 2), 80, 60.0)


def motion(targets, intensity):
    """Transition matrix and noise covariance of targets, whose four states follow each other."""
    step = np.kron([[1.0, 1.0], [0.0, 1.0]], np.eye(2))
    noise = intensity * np.kron([[1 / 3, 1 / 2], [1 / 2, 1.0]], np.eye(2))
    return np.kron(np.eye(targets), step), np.kron(np.eye(targets), noise)


def seen(world, places):
    """What a sensor without noise would see of places `(..., 2)`."""
    return np.stack([np.hypot(*np.moveaxis(places, -1, 0)), np.arctan2(places[..., 1], places[..., 0])], -1) if world.polar else places


def made(world, seed):
    """Draw a run: true states `(t, targets, 4)`, the targets' own plots `(t, targets, 2)`, NaN if not seen, and scans in random order."""
    random = np.random.default_rng(seed)
    count, (A, Q) = len(world.starts), motion(1, world.intensity)
    states = np.empty((world.scans, count, 4))
    states[0] = [np.asarray(mean) + np.sqrt(variances) * random.normal(size=4) for mean, variances in world.starts]
    for t in range(1, world.scans):
        states[t] = states[t - 1] @ A.T + random.multivariate_normal(np.zeros(4), Q, size=count)
    own = seen(world, states[..., :2]) + np.sqrt(world.noise) * random.normal(size=(world.scans, count, 2))
    own[random.random(own.shape[:2]) >= world.detection] = np.nan
    scans = []
    for plots in own:
        false = random.uniform(*world.region, size=(random.poisson(world.rate), 2))
        scans.append(random.permutation(np.concatenate([false, plots[~np.isnan(plots[:, 0])]])))
    return states, own, scans


def counted(world, places, states):
    """Count of estimates `(t, targets, 2)` of a run: whether a target is lost, exchanges of two tracks, and the rms error, m.

    A target is lost if no track is near it at the end, whichever; errors are those of its own track.
    """
    off = np.linalg.norm(places[:, :, None] - states[:, None, :, :2], axis=-1)
    nearest = off[-10:].mean(axis=0).min(axis=0)
    swaps = mo.diagnostics.swaps(places, states[..., :2], world.far) if len(world.starts) > 1 else 0
    own = np.einsum("tii->ti", off)
    return bool((nearest > world.far).any()), swaps / 2, float(np.sqrt(np.mean(own**2)))
