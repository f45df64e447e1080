"""A system among landmarks that nobody knows: its states, and what a sighting says of a landmark."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.core.record import record, static
from motes.core.types import Inputs
from motes.laws.conditional import AdditiveGaussian, Conditional
from motes.laws.gaussian import Gaussian
from motes.laws.law import Law
from motes.laws.map_cloud import parts_of
from motes.laws.mixture import Mixture
from motes.laws.sightings import LandmarkSensor, Sightings
from motes.models.interface import Model, Wrap, exchanged
from motes.models.state_space import StateSpaceModel


@record
class MapModel(Model):
    """A system that moves among landmarks at places that nobody knows, and sights them; for `LandmarkFilter`.

    Measurements are what `mo.sightings` makes of numbered sightings, or an array `(t, s, m)` of those whose landmarks nobody knows, padded
    with NaN. The numbers of the landmarks are the rows of `law.landmarks()`.

    Source: Montemerlo, Thrun 2007, FastSLAM: A Scalable Method for the Simultaneous Localization and Mapping Problem in Robotics.

    Example:
        >>> start, drive = mo.Gaussian([0.0, 0.0], 1e-6 * jnp.eye(2)), mo.AdditiveGaussian(lambda x, u, t: x + 0.1, 1e-4 * jnp.eye(2))
        >>> seen, born, noise = lambda x, l, u, t: l - x, lambda x, z: mo.Gaussian(x + z, 0.01 * jnp.eye(2)), 0.01 * jnp.eye(2)
        >>> model = mo.MapModel(start, drive, seen, noise, birth=born, landmarks=3)
        >>> xs, ys = mo.simulate(0, model.among([[1.0, 2.0], [3.0, -1.0], [5.0, 1.0]]), 50)
        >>> mo.run(1, mo.LandmarkFilter(n=100), model, ys).state.landmarks().mean.shape
        (3, 2)

    Attributes:
        initial: law of the states at step 0; a Gaussian where some are linear.
        dynamics: law of the states given those before, with additive Gaussian noise.
        sensor: see `LandmarkSensor`.
        birth: `(x, z)` gives the law of a landmark `(d,)` at its first sighting from a state, a `Gaussian` or a `Mixture`.
        landmarks: most landmarks, L.
        linear: indices of states that are linear-Gaussian given the path of the others, such as biases of the odometry; sightings may not
            see them.
        names: names of the states.
    """

    initial: Law
    dynamics: Conditional
    sensor: LandmarkSensor
    birth: Callable[[Any, Any], Any]
    landmarks: int = static()
    linear: tuple[int, ...] = static(default=())  # type: ignore[assignment]
    names: tuple[str, ...] = static(default=())

    def __init__(  # noqa: PLR0913 (a model and a sensor, whose numbers stand beside each other)
        self, initial: Law, dynamics: Conditional, sensor: Callable[..., Any], noise: Any, *, birth: Callable[..., Any], landmarks: int,
        linear: tuple[str | int, ...] = (), angles: tuple[int, ...] = (), outliers: tuple[float, float] | None = None, limit: float = 100.0,
        names: tuple[str, ...] = (),
    ):  # fmt: skip
        """Check what can be known without a measurement.

        Args:
            initial: law of the states at step 0.
            dynamics: `AdditiveGaussian` or `LinearGaussian`.
            sensor: `(x, l, u, t)` of one state and one landmark `(d,)` returns the expected measurement `(m,)`.
            noise: covariance of its error, `(m, m)`.
            birth: see the attributes.
            landmarks: see the attributes.
            linear: states by name or index.
            angles: components of a measurement that are angles in radians.
            outliers: share of sightings that are of nothing, and their density per unit of measurement space; None for none.
            limit: squared distance, in standard deviations, beyond which a sighting is not of a landmark: it is an outlier (with
                `outliers`), or, where nobody says which landmark it is of, of a new one.
            names: names of the states.

        Raises:
            MotesError: an argument has a value it cannot have.
        """
        for name, value in (("sensor", sensor), ("birth", birth)):
            if not callable(value):
                checks.refuse(f"MapModel {name}", "a function", type(value).__name__)
        noise = checks.as_float("MapModel noise", noise)
        checks.covariance("MapModel noise", noise, jnp.shape(noise)[0] if jnp.ndim(noise) == 2 else 0, definite=True)
        checks.positive_integer("MapModel landmarks", landmarks)
        checks.above_zero("MapModel limit", limit)
        share, density = (None, 1.0) if outliers is None else outliers
        if outliers is not None:
            checks.probability("MapModel outliers share", share)
            checks.above_zero("MapModel outliers density", density)
        if not isinstance(dynamics, AdditiveGaussian):
            checks.refuse("MapModel dynamics", "AdditiveGaussian or LinearGaussian", type(dynamics).__name__)
        known = StateSpaceModel(initial, dynamics, AdditiveGaussian(lambda x, u, t: x, np.eye(1)), names)
        fields = {"initial": known.initial, "dynamics": dynamics, "birth": birth, "landmarks": landmarks, "names": known.names,
                  "sensor": LandmarkSensor(sensor, noise, share, density, limit, tuple(angles)),
                  "linear": tuple(sorted(known.index(state) for state in linear))}  # fmt: skip
        for name, value in fields.items():
            object.__setattr__(self, name, value)

    @property
    def dtype(self) -> jnp.dtype:
        """Floating type of the states."""
        return self.localization.dtype

    @property
    def circular(self) -> tuple[int, ...]:  # type: ignore[override]
        """Indices of the states that are angles, as the dynamics declare."""
        return self.localization.circular

    @property
    def localization(self) -> StateSpaceModel:
        """The same system with its landmarks at zero: what moves, and what form measurements have."""
        return self.among(jnp.zeros((self.landmarks, self._born(self._state, self._measured)[0].shape[1])))

    def among(self, places: Any) -> StateSpaceModel:
        """Return the system among landmarks at known places `(L, d)`: to locate it, and to simulate, where it sights each at each step.

        Raises:
            MotesError: the places are no such numbers.
        """
        places = checks.as_float("places", places)
        checks.shape("places", places, (self.landmarks, None), "(landmarks, d)")
        checks.finite("places", places)
        return StateSpaceModel(self.initial, self.dynamics, Sightings(self.sensor, places), self.names)

    @property
    def _state(self) -> jax.ShapeDtypeStruct:
        return jax.eval_shape(self.initial.mean)

    @property
    def _measured(self) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct(self.sensor.noise.shape[:1], self._state.dtype)

    def _born(self, x: Any, z: Any) -> tuple[jax.ShapeDtypeStruct, ...]:
        return jax.eval_shape(self.born, x, z)

    @property
    def form(self) -> tuple[jax.ShapeDtypeStruct, ...]:
        """Shapes of centers `(J, d)`, covariances `(J, d, d)` and log weights `(J,)` of a landmark."""
        return self._born(self._state, self._measured)

    def born(self, x: jax.Array, z: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Return centers `(J, d)`, covariances `(J, d, d)` and log weights `(J,)` of a landmark sighted for the first time.

        Raises:
            MotesError: birth gives no Gaussian and no Mixture.
        """
        law = self.birth(x, z)
        if not isinstance(law, (Gaussian, Mixture)):
            checks.refuse("birth(x, z)", "a Gaussian or a Mixture", type(law).__name__)
        centers, covs, log_shares = parts_of(law)
        return centers.astype(x.dtype), covs.astype(x.dtype), log_shares.astype(x.dtype)

    def check(self, inputs_of_step: Inputs) -> None:
        """Run all functions on shapes alone and refuse what does not fit.

        Raises:
            MotesError: a function returns the wrong shape; the message names it.
        """
        known = self.localization
        known.check(inputs_of_step)
        step = jax.ShapeDtypeStruct((), jnp.int32)
        place = jax.ShapeDtypeStruct(self.form[0].shape[1:], self.dtype)
        function = self.sensor.function
        found = jax.eval_shape(lambda *args: jnp.asarray(function(*args)), self._state, place, inputs_of_step, step)
        checks.shape("sensor(x, l, u, t)", jnp.zeros(found.shape), self._measured.shape, "(the size of the noise)")

    def measurement_size(self, inputs_of_step: Inputs) -> None:
        """Return None: a set of sightings is no vector."""

    def each_mode(self) -> tuple[StateSpaceModel, ...]:
        """Return the system with its landmarks at zero, for the form of its measurements."""
        return (self.localization,)

    def as_state_space(self) -> StateSpaceModel:
        """Refuse: the landmarks have no law before they are sighted.

        Raises:
            MotesError: always.
        """
        hint = "Use LandmarkFilter, or model.among(places) where the places are known."
        checks.refuse("model", "a model whose states all have a law at the start", "MapModel", hint)

    def rebuilt(self, wrap: Wrap, u: Any, y: Any) -> "MapModel":
        """Exchange the functions; see `Model`."""
        x, t = self._state, jax.ShapeDtypeStruct((), jnp.int32)
        place = jax.ShapeDtypeStruct(self.form[0].shape[1:], self.dtype)
        function = wrap.function(self.sensor.function, (x, place, u, t), "sensor(x, l, u, t)")
        return exchanged(self, {
            "dynamics": wrap.conditional("dynamics", self.dynamics, x, u, x),
            "sensor": exchanged(self.sensor, {"function": function}),
            "birth": wrap.function(self.birth, (x, self._measured), "birth(x, z)"),
        })

