"""Errors of an inertial navigation system, seen by a radio altimeter over a map (Dahia et al. 2004; the position noise is our choice).

Nine states, north, east, down: position errors rN, rE, rD (m), velocity errors vN, vE, vD (m/s) and slowly varying acceleration errors
aN, aE, aD (m/s^2); or the fifteen of `models.inertial`, among which are those of position and velocity. An error is what must be ADDED to
the inertial value to get the true one, so the true altitude is the inertial altitude minus rD, down being positive. The altimeter measures

    height above terrain = true altitude - map(true north, true east) + noise.

Only rN and rE enter nonlinearly.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.applications.terrain.cruise import Cruise, along_axes, deviations, dynamics
from motes.applications.terrain.settings import INERTIAL, NOISES, PRIOR, Inertial, Noises, Prior
from motes.bounds.at_truth import kalman_at_truth
from motes.core import checks
from motes.core.record import record, replace, static, values
from motes.laws.conditional import AdditiveGaussian, LinearGaussian
from motes.laws.gaussian import Gaussian
from motes.models import inertial
from motes.models.state_space import StateSpaceModel
from motes.models.terrain import TerrainMap

NAMES = ("rN", "rE", "rD", "vN", "vE", "vD", "aN", "aE", "aD")

SMALLEST, LARGEST = 1e-9, 1e9


@record
class Track:
    """The inertial track: the model's inputs, each `(t,)`, or the position of one step, each `()`.

    Attributes:
        north: meters north of the map's south-west post.
        east: meters east of it.
        altitude: meters above the map's zero.
        since: seconds since the fix before, where fixes are not evenly spaced; otherwise None.
    """

    north: jax.Array
    east: jax.Array
    altitude: jax.Array
    since: jax.Array | None = None


@record
class HeightAboveTerrain:
    """Expected reading of the altimeter, `f(x, u, t)` `(1,)` in meters; the map is data of it.

    Attributes:
        terrain: the map.
        typical: height to expect where the map has a void, meters.
        places: where the states have rN, rE and rD.
    """

    terrain: TerrainMap
    typical: float
    places: tuple[int, int, int] = static(default=(0, 1, 2))

    def __call__(self, x: jax.Array, u: Track, t: Any) -> jax.Array:
        """Return the height of one state above the terrain."""
        north, east, down = self.places
        ground = self.terrain.height(u.north + x[north], u.east + x[east])
        return (u.altitude - x[down] - jnp.where(jnp.isnan(ground), self.typical, ground))[None]


@record
class NoiseOverVoids:
    """Variance of the altimeter, `R(x, u, t)` `(1, 1)`: over a void the spread of the map's heights comes on top.

    A particle over a void is thus neither punished nor favored for what the map does not know.

    Attributes:
        terrain: the map.
        variance: of the altimeter, m^2.
        spread: variance of the map's heights, m^2.
        places: where the states have rN, rE and rD.
    """

    terrain: TerrainMap
    variance: float
    spread: float
    places: tuple[int, int, int] = static(default=(0, 1, 2))

    def __call__(self, x: jax.Array, u: Track, t: Any) -> jax.Array:
        """Return the variance at one state."""
        north, east, _ = self.places
        ground = self.terrain.height(u.north + x[north], u.east + x[east])
        return (self.variance + jnp.where(jnp.isnan(ground), self.spread, 0.0))[None, None]


@record
class Transition:
    """A of the dynamics as a function of the inputs, for fixes that are not evenly spaced."""

    def __call__(self, x: jax.Array, u: Track, t: Any) -> jax.Array:
        """Return A `(9, 9)`."""
        return transition(u.since)


@record
class ProcessNoise:
    """Q of the dynamics as a function of the inputs, for fixes that are not evenly spaced.

    Attributes:
        position: standard deviations as in `Noises`.
        velocity: likewise.
        acceleration: likewise.
    """

    position: float
    velocity: float
    acceleration: float

    def __call__(self, x: jax.Array, u: Track, t: Any) -> jax.Array:
        """Return Q `(9, 9)`."""
        return process_cov(u.since, self.position, self.velocity, self.acceleration)


def transition(step: Any) -> jax.Array:
    """Return the matrix `(9, 9)` that carries the errors over `step` seconds of constant acceleration."""
    along = jnp.eye(3) + jnp.diag(jnp.ones(2), 1) * step + jnp.diag(jnp.ones(1), 2) * step**2 / 2
    return jnp.kron(along, jnp.eye(3))


def process_cov(step: Any, position: float, velocity: float, acceleration: float) -> jax.Array:
    """Return the covariance `(9, 9)` that the three random walks gather over `step` seconds, exactly integrated.

    Args:
        step: seconds.
        position: m/sqrt(s).
        velocity: m/s/sqrt(s).
        acceleration: m/s^2/sqrt(s).
    """
    noise = np.zeros((3, 3, 3))
    noise[0, 0, 0] = 1.0
    # the integral over s of the outer product of (s, 1, 0), then of (s^2/2, s, 1); the power of the step is that of its place
    noise[1, :2, :2] = [[1 / 3, 1 / 2], [1 / 2, 1]]
    noise[2] = [[1 / 20, 1 / 8, 1 / 6], [1 / 8, 1 / 3, 1 / 2], [1 / 6, 1 / 2, 1]]
    depth = np.arange(3)
    powers = 1 + 2 * depth[:, None, None] - depth[None, :, None] - depth[None, None, :]
    variances = jnp.asarray([position, velocity, acceleration]) ** 2
    along = jnp.sum(variances[:, None, None] * noise * jnp.asarray(step) ** np.maximum(powers, 0), axis=0)
    return jnp.kron(along, jnp.eye(3))


def error_model(
    terrain: TerrainMap,
    noises: Noises = NOISES,
    prior: Prior = PRIOR,
    step: float | None = 0.3,
    kind: Inertial = INERTIAL,
    cruise: Cruise | None = None,
) -> StateSpaceModel:
    """Return the model of the inertial errors; its inputs are a `Track`.

    Args:
        terrain: the map; where it has voids the altimeter's variance depends on the state, otherwise it is constant.
        noises: standard deviations of process and altimeter.
        prior: standard deviations at the first fix.
        step: seconds between fixes, or None where each step's `Track.since` tells (nine states only).
        kind: nine states or fifteen.
        cruise: the flight, for fifteen states.

    Raises:
        MotesError: a standard deviation is not usable (those of the process may be zero), the step is not a positive number, or fifteen
            states are asked for without a cruise or for fixes that are not evenly spaced.
    """
    if kind.states not in (9, 15):
        checks.refuse("inertial states", "9 or 15", kind.states)
    checks.option("inertial grade", kind.grade, tuple(inertial.GRADES))
    for table, given in (("noises", values(noises)), ("prior", values(prior))):
        for name, value in given.items():
            may_be_zero = table == "noises" and name != "altimeter"
            # beyond these the square is lost in float32
            if not (SMALLEST <= value <= LARGEST or (may_be_zero and value == 0)):
                checks.refuse(f"{table} {name}", f"a standard deviation from {SMALLEST:g} to {LARGEST:g}", value)
    if step is not None and not 0 < step < np.inf:
        checks.refuse("step", "a positive number of seconds", step)
    if kind.states == 9:
        names, spread, moves = NAMES, _prior_deviations(prior), _dynamics(noises, step)
    elif step is None or cruise is None:
        checks.refuse("inertial states", "9 where fixes are not evenly spaced or no cruise is given", kind.states)
    else:
        names, spread = inertial.NAMES, deviations(prior)
        moves = dynamics(cruise, inertial.GRADES[kind.grade], noises.position, step)
    return StateSpaceModel(
        initial=Gaussian(jnp.zeros(len(names)), jnp.diag(jnp.asarray(spread**2, jnp.result_type(float)))),
        dynamics=moves,
        sensor=altimeter(terrain, noises.altimeter, names),
        names=names,
    )


def _prior_deviations(prior: Prior) -> np.ndarray:
    return along_axes(
        (prior.horizontal_position, prior.vertical_position),
        (prior.horizontal_velocity, prior.vertical_velocity),
        (prior.horizontal_acceleration, prior.vertical_acceleration),
    )


def _dynamics(noises: Noises, step: float | None) -> LinearGaussian:
    walks = (noises.position, noises.velocity, noises.acceleration)
    if step is None:
        return LinearGaussian(Transition(), ProcessNoise(*walks))
    return LinearGaussian(transition(step), process_cov(step, *walks))


def altimeter(terrain: TerrainMap, deviation: float, names: tuple[str, ...] = NAMES) -> AdditiveGaussian:
    """Return the law of one height above terrain, noise of the given standard deviation (m), for states of the given names."""
    heights = np.asarray(terrain.heights, np.float64)
    typical, spread = float(np.nanmean(heights)), float(np.nanvar(heights))
    places = places_of(names)
    expected = HeightAboveTerrain(terrain, typical, places)
    variance = deviation**2
    if not np.isnan(heights).any() and terrain.beyond == "edge":
        return AdditiveGaussian(expected, jnp.full((1, 1), variance))
    return AdditiveGaussian(expected, NoiseOverVoids(terrain, variance, spread, places))


def places_of(names: Sequence[str]) -> tuple[int, int, int]:
    """Return the indices of rN, rE and rD."""
    return names.index("rN"), names.index("rE"), names.index("rD")


def corrected(track: Track, errors: jax.Array, names: tuple[str, ...] = NAMES) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return north, east and altitude `(t,)` of a track once errors `(t, x)` of states with the given names are added to it."""
    north, east, down = places_of(names)
    return track.north + errors[..., north], track.east + errors[..., east], track.altitude - errors[..., down]


def unaided(model: StateSpaceModel, track: Track) -> np.ndarray:
    """Return standard deviations `(t, 2)` of the north and east errors along a track without altimeter, m, in float64."""
    deaf = replace(model, sensor=LinearGaussian(jnp.zeros((1, model.size)), jnp.eye(1)))
    cov = kalman_at_truth(deaf, jnp.zeros((track.north.shape[0], model.size), model.dtype), track).cov
    places = places_of(model.names)[:2]
    return np.sqrt(np.asarray(cov, np.float64)[:, places, places])
