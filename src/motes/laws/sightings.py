"""Sightings of landmarks: a measurement is a set of them, of which each says which landmark it is of, or leaves that open."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.core.record import record, static
from motes.laws.circular import wrap
from motes.laws.conditional import Conditional
from motes.laws.gaussian import Correction, Gaussian
from motes.laws.law import Law
from motes.laws.observed import Observed, value_of

WANTED = "sightings, as mo.sightings makes them, or an array (steps, sightings, m)"
NONE = -1
"""Stands for the landmark of a sighting that is not there."""


class Sighting(NamedTuple):
    """Sightings of a step, or, with the time axis first, of a run; those that are there come first.

    Attributes:
        landmark: number of the landmark that each is of, int `(s,)`; `NONE` of one that is not there. None where nobody knows.
        z: what was measured, `(s, m)`, NaN of those that are not there.
    """

    landmark: Any
    z: Any

    @classmethod
    def of(cls, y: Any) -> "Sighting":
        """Return the sightings of a measurement."""
        value = value_of(y)
        return cls(value["landmark"], value["z"]) if isinstance(value, dict) else cls(None, value)

    @property
    def count(self) -> jax.Array:
        """How many there are, `()`."""
        return jnp.sum(~jnp.all(jnp.isnan(self.z), axis=-1))


def sightings(steps: Any) -> Observed:
    """Bring the sightings of a run into the form in which filters are given them.

    Args:
        steps: for each step a dictionary or a list of pairs of a landmark's number and what was measured of it, `{3: [range, bearing]}`;
            a landmark may be sighted more than once in a list. None or nothing where nothing was sighted.

    Returns:
        An object with `value`, landmarks `(t, s)` and measurements `(t, s, m)`, and `there`, whether there was any, `(t,)`.

    Raises:
        MotesError: a step has another form, a landmark is no number from 0 on, or measurements differ in their number of components.
    """
    if isinstance(steps, Observed):
        return steps
    pairs = [list(step.items() if isinstance(step, dict) else step or ()) for step in steps]
    for place, step in enumerate(pairs):
        for pair in step:
            if len(pair) != 2 or isinstance(pair[0], bool) or not isinstance(pair[0], (int, np.integer)) or pair[0] < 0:
                checks.refuse(f"sightings step {place}", "pairs (landmark, measurement), landmarks numbered from 0 on", pair)
    rows = [[np.atleast_1d(checks.as_numbers(f"sightings step {place}", z)) for _, z in step] for place, step in enumerate(pairs)]
    sizes = {row.shape for step in rows for row in step}
    if len(sizes) != 1 or len(next(iter(sizes))) != 1:
        checks.refuse("sightings", "measurements (m,) of one number of components", " and ".join(map(str, sorted(sizes))) or "none")
    most = max(map(len, rows))
    z = np.full((len(rows), most, *sizes.pop()), np.nan)
    landmark = np.full((len(rows), most), NONE, np.int32)
    for place, (step, measured) in enumerate(zip(pairs, rows, strict=True)):
        for i, row in enumerate(measured):
            z[place, i], landmark[place, i] = row, step[i][0]
    return Observed({"landmark": landmark, "z": z}, np.array([bool(step) for step in rows]))


@record
class LandmarkSensor:
    """What a sighting says of a landmark.

    Attributes:
        function: `(x, l, u, t)` of one state and one landmark `(d,)` returns the expected measurement `(m,)`.
        noise: covariance of its error, `(m, m)`.
        share: of sightings that are of nothing; None where none are.
        density: of such, per unit of measurement space.
        limit: squared distance, in standard deviations, beyond which a sighting is not of a landmark.
        angles: components that are angles in radians.
    """

    function: Any
    noise: jax.Array
    share: Any
    density: Any
    limit: Any
    angles: tuple[int, ...] = static(default=())

    def expected(self, X: jax.Array, places: jax.Array, u: Any, t: Any) -> jax.Array:
        """Return what is expected of landmarks `(d, n)` from states `(x, n)`, `(m, n)`."""
        return jax.vmap(lambda x, place: self._at(x, place, u, t), in_axes=-1, out_axes=-1)(X, places)

    def _at(self, x: jax.Array, place: jax.Array, u: Any, t: Any) -> jax.Array:
        return jnp.asarray(self.function(x, place, u, t)).astype(x.dtype)

    def slopes(self, X: jax.Array, places: jax.Array, u: Any, t: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Return the same with its derivatives by the states `(m, x, n)` and by the landmarks `(m, d, n)`."""

        def one(x: jax.Array, place: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
            by_state, by_place = jax.jacfwd(self._at, (0, 1))(x, place, u, t)
            return self._at(x, place, u, t), by_state, by_place

        return jax.vmap(one, in_axes=-1, out_axes=-1)(X, places)

    def innovation(self, z: jax.Array, expected: jax.Array) -> jax.Array:
        """Return how far a measurement `(m,)` is from what was expected, `(m, n)`."""
        return wrap(z[:, None] - expected, self.angles)

    def corrected(self, X: jax.Array, landmarks: Gaussian, z: jax.Array, u: Any, t: Any) -> Correction[Gaussian]:
        """Condition laws of landmarks `(d, n)` on a sighting from states `(x, n)`, by the function's line at their means."""
        expected, _, slope = self.slopes(X, landmarks.center, u, t)
        return landmarks.corrected(self.innovation(z, expected), slope, self.noise)

    def is_near(self, log_evidence: jax.Array, most: jax.Array) -> jax.Array:
        """Tell whether a sighting of some log density, at most so large, can be of a landmark."""
        return 2 * (most - log_evidence) <= self.limit

    def among_outliers(self, log_likelihood: jax.Array) -> jax.Array:
        """Return log likelihoods when a share of sightings is of nothing."""
        return log_likelihood if self.share is None else jnp.logaddexp(jnp.log1p(-self.share) + log_likelihood, self.of_nothing)

    @property
    def of_nothing(self) -> jax.Array:
        """Log likelihood of a sighting that is of no landmark."""
        return jnp.full((), -jnp.inf) if self.share is None else jnp.log(self.share) + jnp.log(self.density)


@record
class Sightings(Conditional):
    """The sensor of landmarks at known places, for localization: each sighting says which landmark it is of.

    Attributes:
        sensor: of one.
        places: of the landmarks, `(L, d)`.
    """

    measures_anything = True
    sensor: LandmarkSensor
    places: jax.Array

    def packed(self, ys: Any) -> Any:
        """Take what `mo.sightings` takes and gives, arrays `{"landmark": (t, s), "z": (t, s, m)}`, or an array `(t, s, m)`.

        Raises:
            MotesError: they are none of these, a measurement has another number of components, or there is no landmark of a number.
        """
        if type(ys) in (list, tuple) and all(step is None or isinstance(step, (dict, list, tuple)) for step in ys):
            ys = sightings(ys)
        value = value_of(ys)
        named = isinstance(value, dict) and value.keys() == {"landmark", "z"}
        z = checks.as_numbers("ys", value["z"] if named else value, WANTED) if named or not isinstance(value, dict) else None
        size = self.sensor.noise.shape[0]
        if z is None or np.ndim(z) != 3 or z.shape[2] != size:
            given = f"a {type(value).__name__}" + ("" if z is None else f" of shape {np.shape(z)}")
            checks.refuse("ys", f"{WANTED}, measurements of {size} components", given)
        if not named:
            return value if isinstance(ys, Observed) else z
        landmark = checks.as_numbers("ys landmark", value["landmark"], "whole numbers")
        checks.shape("ys landmark", landmark, z.shape[:2], "(as the sightings)")
        if not jnp.issubdtype(landmark.dtype, jnp.integer):
            checks.refuse("ys landmark", "whole numbers", str(landmark.dtype))
        if checks.is_concrete((landmark, z)):
            there, count = np.asarray(landmark) >= 0, len(self.places)
            if (np.asarray(landmark) >= count).any():
                hint = "Say landmarks= that many."
                checks.refuse("ys landmark", f"numbers of the {count} landmarks, from 0 on", int(np.max(landmark)), hint)
            if (there == np.isnan(np.asarray(z)).any(axis=2)).any() or (there[:, 1:] & ~there[:, :-1]).any():
                wanted = "whole measurements where a landmark is named, those that are there first"
                checks.refuse("ys", wanted, "others", "mo.sightings makes them.")
            return Observed({"landmark": np.asarray(landmark, np.int32), "z": z}, there.any(axis=1))
        return ys if isinstance(ys, Observed) else Observed({"landmark": landmark, "z": z}, jnp.any(landmark >= 0, axis=1))

    def given(self, x: jax.Array, u: Any, t: Any) -> Law:
        """Refuse: a set of sightings is no vector."""
        checks.refuse("Sightings", "a sensor of vectors (its moments are asked for)", "sets of sightings", "Use a ParticleFilter.")

    def sample(self, key: jax.Array, X: jax.Array, u: Any, t: Any) -> Observed:
        """Draw a sighting of each landmark for each particle, `(L, m, n)`."""
        count, n = len(self.places), X.shape[1]
        expected = jax.vmap(lambda place: self._expected(place, X, u, t))(self.places)
        noise = self.sensor.noise.astype(X.dtype)
        error = Gaussian(jnp.zeros(len(noise), X.dtype), noise).sample(key, count * n).reshape(-1, count, n)
        landmark = jnp.broadcast_to(jnp.arange(count, dtype=jnp.int32)[:, None], (count, n))
        return Observed({"landmark": landmark, "z": expected + jnp.swapaxes(error, 0, 1)}, jnp.ones((n,), bool))

    def _expected(self, place: jax.Array, X: jax.Array, u: Any, t: Any) -> jax.Array:
        everywhere = jnp.broadcast_to(place[:, None], (place.shape[0], X.shape[1])).astype(X.dtype)
        return self.sensor.expected(X, everywhere, u, t)

    def log_prob(self, value: Any, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Log density of the sightings of a step given each particle, `(n,)`."""
        seen = Sighting.of(value)
        if seen.landmark is None:
            checks.refuse("Sightings", "sightings that say which landmark they are of", "an array", "mo.sightings makes them.")

        def one(landmark: jax.Array, z: jax.Array) -> jax.Array:
            off = self.sensor.innovation(z, self._expected(self.places[landmark], X, u, t))
            found = Gaussian(jnp.zeros_like(z), self.sensor.noise.astype(X.dtype)).log_prob(off)
            return jnp.where((landmark == NONE) | jnp.all(jnp.isnan(z)), 0, self.sensor.among_outliers(found))

        return jnp.sum(jax.vmap(one)(seen.landmark, jnp.asarray(seen.z)), axis=0)
