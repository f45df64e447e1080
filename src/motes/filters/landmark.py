"""Particles that each carry a map of landmarks (FastSLAM; Montemerlo, Thrun, Koller, Wegbreit 2002 and 2003).

Landmarks are independent of each other given the path, so that each particle has one small Kalman filter, or a mixture of such, for each.

1. Resample particles with their maps where the policy says so.
2. Move them by the dynamics, or, knowing the sightings, by a Gaussian that they have corrected (FastSLAM 2); states that are linear given
   the path are corrected by where each particle went.
3. Each sighting in turn: weigh each particle by its predictive density, and correct the landmark; the first sighting of one gives birth
   to it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from motes.core import checks, random
from motes.core.record import record, replace, static
from motes.filters.clouds import resample_and_move
from motes.filters.info import Info, weigh
from motes.filters.interface import Guide, TwoStageFilter
from motes.filters.look_ahead import Ahead, LookAheadFilter, keys_of
from motes.filters.marginal_moves import expected_places, first_particles, moved
from motes.laws.conditional import AdditiveGaussian
from motes.laws.gaussian import Gaussian
from motes.laws.map_cloud import Map, MapCloud
from motes.laws.sightings import NONE, Sighting
from motes.models.map_model import MapModel
from motes.models.split import SplitModel, split
from motes.models.state_space import StateSpaceModel
from motes.resampling.policy import ESS, Policy, resample
from motes.resampling.schemes import Scheme, Systematic

C = TypeVar("C")
SURE = 0.9
"""Share that one Gaussian of a landmark must have for its sighting to move particles."""


@record
class Prepared:
    """A map model ready for the filter.

    Attributes:
        map: the model.
        path: its states without landmarks, split into particle and Kalman parts.
    """

    map: MapModel
    path: SplitModel

    @property
    def circular(self) -> tuple[int, ...]:
        """Indices of the states that are angles, in the user's order."""
        return self.map.circular


class Sighted(NamedTuple):
    """What sightings of a step have said so far.

    Attributes:
        map: landmarks.
        log_likelihood: of each particle, `(n,)`.
        most: largest value that it could have, `(n,)`.
    """

    map: Map
    log_likelihood: jax.Array
    most: jax.Array


@record
class LandmarkFilter(LookAheadFilter[MapCloud], TwoStageFilter[MapCloud]):
    """FastSLAM: a particle filter whose particles carry maps; its state is a `MapCloud`, for a `MapModel`.

    A step costs as much as its sightings, whatever the number of landmarks, but for resampling, which copies maps. Where nobody says which
    landmark a sighting is of, each particle takes the most likely one, or a new one beyond the model's `limit`.

    Source: Montemerlo, Thrun, Koller, Wegbreit 2003, FastSLAM 2.0: An improved particle filtering algorithm for simultaneous localization
    and mapping that provably converges.

    Example:
        >>> start, drive = mo.Gaussian([0.0, 0.0], 1e-6 * jnp.eye(2)), mo.AdditiveGaussian(lambda x, u, t: x + 0.1, 1e-4 * jnp.eye(2))
        >>> seen, born, noise = lambda x, l, u, t: l - x, lambda x, z: mo.Gaussian(x + z, 0.01 * jnp.eye(2)), 0.01 * jnp.eye(2)
        >>> model = mo.MapModel(start, drive, seen, noise, birth=born, landmarks=3)
        >>> xs, ys = mo.simulate(0, model.among([[1.0, 2.0], [3.0, -1.0], [5.0, 1.0]]), 50)
        >>> mo.run(1, mo.LandmarkFilter(n=100), model, ys).mean.shape
        (50, 2)

    Attributes:
        n: number of particles.
        proposal: whether particles move knowing the sightings (FastSLAM 2), but for landmarks that are not yet one Gaussian.
        scheme: how ancestors are drawn.
        policy: when to resample, at the start of a step.
    """

    starves = True
    guide = Guide(
        needs="a MapModel: states with Gaussian noise, and what a sighting says of a landmark",
        cost="n J d^3 for each sighting, J the Gaussians of a landmark of d numbers; n L J d^2 to resample L of them",
        use="landmarks or beacons at unknown places (SLAM)",
    )

    n: int = static()
    proposal: bool = static(default=True)
    scheme: Scheme = Systematic()
    policy: Policy = ESS(0.5)

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: n is not a positive whole number, or proposal is neither True nor False.
        """
        checks.positive_integer("LandmarkFilter n", self.n)
        checks.instance("LandmarkFilter proposal", self.proposal, bool, "True or False")

    @property
    def look_ahead(self) -> bool:  # type: ignore[override]
        """With a proposal the filter moves only when it knows the sightings."""
        return self.proposal

    def prepare(self, model: Any, u: Any) -> Prepared:
        """Split the states of a map model into particle and Kalman parts.

        Raises:
            MotesError: it is none, or sightings see a state that is to be in the Kalman part.
        """
        checks.instance("LandmarkFilter model", model, MapModel, "a MapModel")
        nowhere = jnp.zeros(model.form[0].shape[1:], model.dtype)
        seen_from = AdditiveGaussian(lambda x, u, t: model.sensor.function(x, nowhere, u, t), model.sensor.noise)
        path = split(StateSpaceModel(model.initial, model.dynamics, seen_from, model.names), model.linear, u)
        if model.linear and path.likelihood is None:
            names = ", ".join(model.names[i] for i in model.linear)
            checks.refuse("MapModel linear", "states that sightings do not see", names, "Take those that they see out.")
        return Prepared(model, path)

    def init(self, key: jax.Array, model: Prepared) -> MapCloud:
        """Draw n particles, each with an empty map."""
        path = first_particles(key, model.path, self.n)
        return MapCloud(path, *Map.empty(model.map.landmarks, model.map.form, self.n))

    def predict(self, key: jax.Array, model: Prepared, state: MapCloud, u: Any, t: Any) -> MapCloud:
        """Resample where needed, then move by the dynamics (steps 1 and 2)."""

        def move(noise_key: jax.Array, cloud: MapCloud) -> MapCloud:
            return replace(cloud, path=moved(noise_key, model.path, cloud.path, state.path.particles[:, 0], u, t))

        keys = (random.child(key, random.RESAMPLE), random.child(key, random.NOISE))
        return resample_and_move(keys, self.scheme, self.policy, state, move)

    def correct(self, key: jax.Array, model: Prepared, state: MapCloud, y: Any, u: Any, t: Any) -> tuple[MapCloud, Info]:
        """Weigh the particles by the sightings, and correct their landmarks (step 3)."""
        found = _taken_in(model, state, y, u, t)
        return _weighed(state, found, found.log_likelihood, found.most)

    def ahead(self, key: jax.Array, model: Prepared, state: MapCloud, y: Any, u: Any, t: Any) -> Ahead:
        """Resample where needed, move knowing the sightings, then weigh and correct (steps 1 to 3)."""
        resample_key, noise_key = keys_of(key)
        parents = resample(resample_key, self.scheme, self.policy, state)
        example = state.path.particles[:, 0]
        expected = expected_places(model.path, parents.path, example, u, t)
        informed = _informed(model, parents.map, expected, y, u, t)
        offset = informed.sample(noise_key, self.n) - expected.center
        log_ratio = Gaussian(jnp.zeros_like(offset), expected.covariance).log_prob(offset) - informed.log_prob(offset + expected.center)
        after = replace(parents, path=moved(noise_key, model.path, parents.path, example, u, t, offset=offset)).gathered(model.circular)
        found = _taken_in(model, after, y, u, t)
        cloud, info = _weighed(after, found, found.log_likelihood + log_ratio, jnp.full((), jnp.inf, log_ratio.dtype))

        def blind() -> MapCloud:
            return replace(parents, path=moved(noise_key, model.path, parents.path, example, u, t)).gathered(model.circular)

        return Ahead(cloud, info, blind)


def _weighed(cloud: MapCloud, found: Sighted, log_likelihood: jax.Array, most: jax.Array) -> tuple[MapCloud, Info]:
    weights, info = weigh(cloud.log_weights, log_likelihood, most)
    return MapCloud(replace(cloud.path, log_weights=weights), *found.map), info


def _taken_in(model: Prepared, cloud: MapCloud, y: Any, u: Any, t: Any) -> Sighted:
    """Take in the sightings of a step, one after the other."""
    seen = Sighting.of(y)
    states = model.path.whole(cloud.path.particles)
    nothing = jnp.zeros(cloud.log_weights.shape, cloud.log_weights.dtype)

    def one(before: Sighted, there: jax.Array, landmark: Any, z: jax.Array) -> Sighted:
        z = z.astype(states.dtype)
        if landmark is None:
            nowhere = jnp.full(nothing.shape, NONE, jnp.int32)
            landmark = jax.lax.cond(there, lambda: _nearest(model.map, before.map, states, z, u, t), lambda: nowhere)
        index = jnp.maximum(landmark, 0)
        before_it = before.map.of(index)
        # what is chosen here is one landmark: maps are too large to be copied for each sighting
        after, weight, most = jax.lax.cond(there, lambda: _sighted(model.map, before_it, states, landmark, z, u, t),
                                           lambda: (before_it, nothing, nothing))  # fmt: skip
        return Sighted(before.map.with_one(index, after), before.log_likelihood + weight, before.most + most)

    return _over_sightings(seen, one, Sighted(cloud.map, nothing, nothing))


def _over_sightings(seen: Sighting, one: Callable[[C, jax.Array, Any, jax.Array], C], first: C) -> C:
    """Go through sightings: `one` gets what it gave before, whether one is there, a landmark's number and a measurement."""
    there = jnp.arange(seen.z.shape[0]) < seen.count
    return jax.lax.scan(lambda before, now: (one(before, *now), None), first, (there, seen.landmark, jnp.asarray(seen.z)))[0]


def _of_each_gaussian(model: MapModel, one: Map, states: jax.Array, z: jax.Array, u: Any, t: Any) -> tuple[Map, jax.Array, jax.Array]:
    """Correct each Gaussian of a landmark; gives also its predictive log density and that of a perfect prediction, `(J, n)`."""
    count, _, n = one.centers.shape
    centers, covs = (jnp.moveaxis(part, 0, -2).reshape(*part.shape[1:-1], count * n) for part in (one.centers, one.covs))
    done = model.sensor.corrected(jnp.tile(states, (1, count)), Gaussian(centers, covs), z, u, t)
    centers, covs = (jnp.moveaxis(part.reshape(*part.shape[:-1], count, n), -2, 0) for part in (done.law.center, done.law.covariance))
    log_evidence, most = done.log_evidence.reshape(count, n), jnp.broadcast_to(done.max_log_evidence, (count * n,)).reshape(count, n)
    return Map(centers, covs, one.log_shares + log_evidence, one.seen), log_evidence, most


def _sighted(
    model: MapModel, one: Map, states: jax.Array, landmark: jax.Array, z: jax.Array, u: Any, t: Any
) -> tuple[Map, jax.Array, jax.Array]:
    """Take in one sighting of a landmark; gives it, the log likelihood of each particle and the largest it could be, `(n,)`."""
    known = landmark >= 0
    corrected, log_evidence, most = _of_each_gaussian(model, one, states, z, u, t)
    total = jax.nn.logsumexp(corrected.log_shares, axis=0)
    near = jnp.any(model.sensor.is_near(log_evidence, most), axis=0)
    corrected = corrected._replace(log_shares=corrected.log_shares - total)
    centers, covs, log_shares = jax.vmap(model.born, in_axes=(-1, None), out_axes=-1)(states, z)
    born = Map(centers, covs, log_shares, jnp.ones_like(one.seen))
    # without outliers a sighting is of its landmark however far it is
    taken = one.seen & (near | (model.sensor.share is None))
    after = Map(*(jnp.where(known & taken, new, jnp.where(known & ~one.seen, first, old))
                  for new, first, old in zip(corrected, born, one, strict=True)))  # fmt: skip
    # a sighting of no landmark is of nothing
    of_new, of_nothing = jnp.zeros_like(total) if known.ndim == 0 else _unseen(model), model.sensor.of_nothing
    weight = jnp.where(known & one.seen, model.sensor.among_outliers(total), jnp.where(known, of_new, of_nothing))
    highest = jnp.where(known & one.seen, model.sensor.among_outliers(jnp.max(most, axis=0)), weight)
    return after, weight.astype(total.dtype), highest.astype(total.dtype)


def _unseen(model: MapModel) -> jax.Array:
    """Log density of a sighting of a landmark that a particle does not know yet: that of one at the limit."""
    at_fit = jnp.zeros(model.sensor.noise.shape[:1], model.sensor.noise.dtype)
    return Gaussian(at_fit, model.sensor.noise).log_prob(at_fit) - model.sensor.limit / 2


def _nearest(model: MapModel, landmarks: Map, states: jax.Array, z: jax.Array, u: Any, t: Any) -> jax.Array:
    """Return for each particle the landmark that a sighting is most likely of, a new one where none is near; -1 where there is no room."""

    def weighed(one: Map) -> tuple[jax.Array, jax.Array]:
        corrected, log_evidence, most = _of_each_gaussian(model, one, states, z, u, t)
        near = one.seen & jnp.any(model.sensor.is_near(log_evidence, most), axis=0)
        return jnp.where(near, jax.nn.logsumexp(corrected.log_shares, axis=0), -jnp.inf), near

    each, near = jax.lax.map(weighed, landmarks)
    count = jnp.sum(landmarks.seen, axis=0).astype(jnp.int32)
    new = jnp.where(count < landmarks.seen.shape[0], count, -1)
    return jnp.where(jnp.any(near, axis=0), jnp.argmax(each, axis=0).astype(jnp.int32), new)


def _informed(model: Prepared, landmarks: Map, expected: Gaussian, y: Any, u: Any, t: Any) -> Gaussian:
    """Correct where particles are expected `(p, n)` by the sightings of landmarks that are one Gaussian (FastSLAM 2)."""
    seen, sensor, own = Sighting.of(y), model.map.sensor, len(expected.center)
    wide = expected.covariance
    wide = jnp.broadcast_to(wide[..., None], (*wide.shape, expected.center.shape[1])) if wide.ndim == 2 else wide
    kept = jnp.array([i for i in range(model.map.size) if i not in model.map.linear], int)

    def one(law: Gaussian, there: jax.Array, landmark: Any, z: jax.Array) -> Gaussian:
        return jax.lax.cond(there, lambda: informed(law, landmark, z), lambda: law)

    def informed(law: Gaussian, landmark: Any, z: jax.Array) -> Gaussian:
        z, states = z.astype(law.center.dtype), model.path.whole(law.center)
        index = _nearest(model.map, landmarks, states, z, u, t) if landmark is None else landmark
        found = landmarks.of(jnp.maximum(index, 0))
        best = jnp.argmax(found.log_shares, axis=0)
        center, cov, log_share = (jnp.take_along_axis(part, best.reshape(1, *[1] * (part.ndim - 2), -1), 0)[0] for part in found[:3])
        predicted, by_state, by_place = sensor.slopes(states, center, u, t)
        noise = Gaussian(jnp.zeros_like(center), cov).through(by_place, jnp.zeros_like(predicted), sensor.noise).covariance
        done = law.corrected(sensor.innovation(z, predicted), by_state[:, kept], noise)
        near = sensor.is_near(done.log_evidence, done.max_log_evidence)
        usable = (index >= 0) & found.seen & (jnp.exp(log_share) > SURE) & near
        return Gaussian(jnp.where(usable, done.law.center, law.center), jnp.where(usable, done.law.covariance, law.covariance))

    return _over_sightings(seen, one, Gaussian(expected.center, wide)) if own else expected
