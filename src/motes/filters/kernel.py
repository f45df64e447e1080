"""Kalman-particle kernel filter (Dahia, Musso, Pham, Guibert 2004, equations 3 to 14): a cloud of small Gaussians.

1. Start with kernels that are small in the nonlinear states only; in the others each holds the full initial covariance.
2. Predict each kernel by the dynamics linearized at its center; where their slope varies, by their plane through sigma points, with what it
   leaves unexplained added to the noise: the slope at a center may be far steeper than the dynamics are over the kernel.
3. Every few steps, select kernels by weight where the weights are uneven (full resampling; otherwise partial), and split wide kernels:
   centers are drawn, covariances shrink, mean and covariance of the mixture stay (`SplitKernels`, or the paper's `CommonKernel`).
4. Correct each kernel by the Kalman filter of the sensor linearized over it, and its weight by N(y - y_i; 0, H P H' + R).
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, linalg, random
from motes.core.logspace import uniform_weights
from motes.core.record import record, replace, static
from motes.filters import alarm
from motes.filters.clouds import resample_and_move, update_weights
from motes.filters.gated import Gated
from motes.filters.info import Info, with_innovation
from motes.filters.interface import Guide, TwoStageFilter
from motes.gaussian.rule import Linearized
from motes.gaussian.sigma_points import regressed_on, through_on, unscaled
from motes.gaussian.taylor import Taylor, affine, slope_in
from motes.laws.conditional import AdditiveGaussian, matrix_over
from motes.laws.density import measured_in
from motes.laws.gaussian import Gaussian
from motes.laws.mixture import Mixture
from motes.models.state_space import StateSpaceModel, as_state_space
from motes.models.structure import largest, trace, varying
from motes.resampling.policy import Entropy, Never, Policy
from motes.resampling.schemes import Scheme, Systematic
from motes.resampling.splitting import Kernels, SplitKernels


@record
class LocalModel:
    """A model with what is known of its slopes.

    Attributes:
        dynamics: with additive Gaussian noise.
        sensor: likewise.
        initial: law of x_0.
        nonlinear: indices of the states in which kernels are small.
        linear: indices of the others.
        affine_dynamics: whether slope and noise of the dynamics are the same at every state.
        shared_sensor_slope: whether the slope of the sensor in the other states is.
        circular: indices of the states that are angles.
        moved_by: for each state, which states its dynamics use: elsewhere their slope is zero.
        seen: which states the sensor uses.
    """

    dynamics: AdditiveGaussian
    sensor: AdditiveGaussian
    initial: Any
    nonlinear: tuple[int, ...] = static()
    linear: tuple[int, ...] = static()
    affine_dynamics: bool = static()
    shared_sensor_slope: bool = static()
    circular: tuple[int, ...] = static()
    moved_by: tuple[tuple[bool, ...], ...] = static()
    seen: tuple[bool, ...] = static()


@record
class KalmanParticleKernelFilter(Gated, TwoStageFilter[Mixture]):
    """Kalman-particle kernel filter; its state is a `Mixture` of n Gaussians with a covariance each.

    Source: Dahia, Musso, Pham, Guibert 2004, Application of the Kalman-particle kernel filter to the updated inertial navigation
    system.

    Example:
        >>> model = mo.textbook.radar_tracking()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.run(1, mo.KalmanParticleKernelFilter(n=200), model, ys).mean.shape
        (50, 6)

    Attributes:
        n: number of kernels.
        nonlinear: states in which kernels are small, by name or index; None for those that the structure of the model leaves nonlinear.
        spread: factor on the initial standard deviation of the nonlinear states, so that their tails have kernels too; the
            filter's own prior is wider than the model's by it.
        width: standard deviation of an initial kernel along the nonlinear states, as a share of that of the initial law (times `spread`).
        every: steps between resamplings; None for 10 where the slope of the dynamics is the same at every state, and 1 elsewhere, where
            kernels soon outgrow what a plane fits.
        kernels: how kernels are kept small.
        slope: "sigma": the sensor is regressed on the nonlinear states over sigma points of each kernel, and the variance that the
            slope leaves unexplained is added to R; "jacobian": its slope at the center, which is faster.
        scheme: how kernels are selected.
        policy: when a resampling selects; otherwise it splits and keeps the weights.
    """

    subtracts = True
    guide = Guide(
        needs="additive Gaussian noises",
        cost="n x^2, n x^3 to move covariances",
        use="several modes in few nonlinear states, many linear ones, little process noise",
    )

    n: int = static()
    nonlinear: tuple[str | int, ...] | None = static(default=None)
    spread: float = 1.3
    width: float = 0.1
    every: int | None = static(default=None)
    kernels: Kernels = SplitKernels()
    slope: str = static(default="sigma")
    scheme: Scheme = Systematic()
    policy: Policy = Entropy(0.5)

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: a number is out of range, or a word is unknown.
        """
        checks.positive_integer("KalmanParticleKernelFilter n", self.n)
        if self.every is not None:
            checks.positive_integer("KalmanParticleKernelFilter every", self.every)
        checks.above_zero("KalmanParticleKernelFilter spread", self.spread)
        checks.above_zero("KalmanParticleKernelFilter width", self.width, 1.0)
        checks.option("KalmanParticleKernelFilter slope", self.slope, ("sigma", "jacobian"))
        if self.nonlinear is not None:
            object.__setattr__(self, "nonlinear", (self.nonlinear,) if isinstance(self.nonlinear, str) else tuple(self.nonlinear))

    def prepare(self, model: Any, u: Any) -> LocalModel:
        """Ask for additive Gaussian noises, and find the nonlinear states and which slopes are shared.

        Raises:
            MotesError: a noise is of another kind, or there is no such state.
        """
        known = getattr(model, "linear", None)
        model = as_state_space("KalmanParticleKernelFilter", model)
        for name in ("dynamics", "sensor"):
            part = getattr(model, name)
            if not isinstance(part, AdditiveGaussian):
                checks.refuse(f"KalmanParticleKernelFilter {name}", "additive Gaussian noise (kernels are corrected by Kalman filters)",
                              type(part).__name__, "Use a ParticleFilter or a RegularizedParticleFilter.")
        return self._local(model, known, u)

    def _local(self, model: StateSpaceModel, known: tuple[int, ...] | None, u: Any) -> LocalModel:
        traced, size = trace(model, u), model.size
        if self.nonlinear is None:
            linear = largest(traced, size) if known is None else known
        else:
            linear = tuple(sorted(set(range(size)) - {model.index(state) for state in self.nonlinear}))
        bends = traced.slope_pairs["dynamics"][:, :size, :size].any() or traced.noise_uses["dynamics"][:size].any()
        moving = varying(traced, linear, size).get("sensor slope")
        shared_sensor_slope = moving is None or not moving[:size].any()
        nonlinear = tuple(i for i in range(size) if i not in linear)
        used = (tuple(map(tuple, traced.moved_by.tolist())), tuple(traced.direct.tolist()))
        about = (nonlinear, linear, not bends, shared_sensor_slope, model.circular, *used)
        return LocalModel(model.dynamics, model.sensor, model.initial, *about)  # type: ignore[arg-type]

    def init(self, key: jax.Array, model: LocalModel) -> Mixture:
        """Draw n centers along the nonlinear states, the others by regression, each with what is left of the covariance (step 1)."""
        mean, cov = model.initial.mean(), model.initial.cov()
        factor = linalg.cholesky(linalg.take(linalg.take(cov, model.nonlinear), model.nonlinear, axis=1))
        along = linalg.transpose(linalg.solve_lower(factor, linalg.take(cov, model.nonlinear)))
        off = linalg.take(model.initial.sample(key, self.n) - mean[:, None], model.nonlinear)
        moved = linalg.times_vector(along, linalg.solve_lower(factor, off))
        centers = mean[:, None] + self.spread * jnp.sqrt(1 - jnp.square(self.width)) * moved
        factors = jnp.stack([jnp.ones(()), jnp.square(self.spread * self.width) - 1]).astype(cov.dtype)
        terms = jnp.stack([cov, linalg.symmetric(linalg.product_transposed(along, along))], axis=-1)
        # as a matrix product: compilers would fuse a plain sum into the first correction and round it otherwise than where both are apart
        kernels = linalg.product(terms.reshape(-1, 2), jnp.broadcast_to(factors[:, None], (2, self.n))).reshape(*cov.shape, self.n)
        return Mixture(Gaussian(centers.astype(cov.dtype), kernels), uniform_weights(self.n, cov.dtype))

    def predict(self, key: jax.Array, model: LocalModel, state: Mixture, u: Any, t: Any) -> Mixture:
        """Move the kernels (step 2); every few steps select and split them (step 3)."""
        keys = (random.child(key, random.RESAMPLE), random.child(key, random.NOISE))
        example = state.parts.center[:, 0]
        regressed = not model.affine_dynamics and bool(model.nonlinear)
        shared = _once(t, lambda: affine(model.dynamics, example, u, t)[1:]) if model.affine_dynamics else None

        def move(noise_key: jax.Array, law: Mixture) -> Mixture:
            parts = _by_one_triangle(law.parts)
            if regressed:
                return replace(law, parts=through_on(model.dynamics, model.nonlinear, parts, u, t))
            if shared is None:
                return replace(law, parts=Taylor().through(model.dynamics, parts, u, t))
            slope, noise = shared
            slope = jnp.where(np.array(model.moved_by), slope, 0)
            return replace(law, parts=Linearized(model.dynamics.means(parts.center, u, t), slope, noise).over(parts))

        def selected_and_split(law: Mixture) -> Mixture:
            split = self.kernels.fitted(law, model.nonlinear)
            smaller = lambda key, law: split(key, replace(law, parts=_by_one_triangle(law.parts)))  # noqa: E731
            return resample_and_move(keys, self.scheme, self.policy, law, smaller)

        due = t % (self.every or (10 if model.affine_dynamics else 1)) == 0
        # 2. predict; nothing is resampled
        moved = resample_and_move(keys, self.scheme, Never(), state, move).gathered(model.circular)
        # 3. select and split
        return jax.lax.cond(due, selected_and_split, lambda law: law, moved)

    def correct(self, key: jax.Array, model: LocalModel, state: Mixture, y: jax.Array, u: Any, t: Any) -> tuple[Mixture, Info]:
        """Correct each kernel by y, and weigh it by its predictive density of y (step 4)."""
        sensor = model.sensor
        example = state.parts.center[:, 0]
        shared = _once(t, lambda: slope_in(sensor, model.linear, example, u, t)) if model.shared_sensor_slope else None

        def likelihood_of(law: Mixture) -> tuple[Mixture, jax.Array, jax.Array]:
            before = _by_one_triangle(law.parts)
            X, R = before.center, matrix_over(sensor.Q, before.center, u, t)
            if self.slope == "sigma":
                cov = before.covariance
                factor = linalg.cholesky(linalg.take(linalg.take(cov, model.nonlinear), model.nonlinear, axis=1))
                prediction, scaled_slope, unexplained = regressed_on(sensor, model.nonlinear, X, factor, u, t)
                slope_nonlinear, R = unscaled(scaled_slope, factor), linalg.add(unexplained, R)
            else:
                prediction, slope_nonlinear = sensor.means(X, u, t), slope_in(sensor, model.nonlinear, X, u, t)
            sees = np.array(model.seen)[list(model.linear)]
            slope_linear = slope_in(sensor, model.linear, X, u, t) if shared is None else jnp.where(sees, shared, 0)
            parts = ((model.nonlinear, slope_nonlinear), (model.linear, slope_linear))
            done = before.corrected_in_turn(sensor.residual(y, prediction), parts, R, measured_in(y, R))
            return replace(law, parts=done.law), done.log_evidence, done.max_log_evidence

        after, info = update_weights(state, likelihood_of)
        some = alarm.some_of(self.n)
        few = Gaussian(state.parts.center[:, some], state.parts.covariance[..., some])
        predicted = Taylor().through(sensor, few, u, t)
        found = alarm.of_mixture(sensor.angles, predicted.center, predicted.covariance, state.log_weights[some], y)
        return after, with_innovation(info, found)


def _by_one_triangle(laws: Gaussian) -> Gaussian:
    """Read covariances by their lower triangles: native kernels then load no other."""
    return Gaussian(laws.center, linalg.mirrored(laws.covariance))


def _once(t: Any, work: Callable[[], Any]) -> Any:
    """Work out what all kernels share in a branch of its own: compilers would fuse it into loops and do it again for every kernel."""
    nothing = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), jax.eval_shape(work))
    return jax.lax.cond(t >= 0, work, lambda: nothing)
