"""What a rule for moments answers: the linear conditional that stands for any other one near a Gaussian (statistical linearization).

z given x is replaced by z = prediction + slope (x - mean) + e, e of covariance noise. With N(m, P) for x the mean of z is the prediction
and its covariance slope P slope' + noise; a measurement of z conditions x as in a Kalman filter. Everything that takes a Gaussian through
a function asks a rule: filters whose law is one Gaussian or a bank of them, and the smoothers that follow them.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp

from motes.core import checks, linalg
from motes.laws.conditional import Conditional
from motes.laws.density import measured_in
from motes.laws.gaussian import Correction, Gaussian


class Linearized(NamedTuple):
    """A linear conditional that stands for another one near a Gaussian; of n Gaussians with the particle axis last.

    Attributes:
        prediction: mean of the value over the Gaussian, `(z, *n)`.
        slope: `(z, x, *n)`.
        noise: covariance of the value about the line, `(z, z, *n)`.
    """

    prediction: jax.Array
    slope: jax.Array
    noise: jax.Array

    def over(self, law: Gaussian, spread: Sequence[int] | None = None) -> Gaussian:
        """Return the law of the value, given that of the state; spread names the states that have variance, None for all."""
        slope, law = (self.slope, law) if spread is None else (linalg.take(self.slope, spread, axis=1), law.marginal(spread))
        return Gaussian(self.prediction, linalg.add(linalg.sandwich(slope, law.covariance), self.noise))

    def of(self, components: Sequence[int]) -> "Linearized":
        """Return the same for some components of the value."""
        noise = linalg.take(linalg.take(self.noise, components), components, axis=1)
        return Linearized(linalg.take(self.prediction, components), linalg.take(self.slope, components), noise)


class Rule(ABC):
    """A way to take a Gaussian through a conditional. Rules are records of their own parameters.

    Laws are one Gaussian, mean `(x,)`, or a batch of n, means `(x, n)`, each of which is treated on its own.
    """

    exact: ClassVar[bool] = False
    """Whether the rule is for linear models alone, which the filter then asks for."""

    def check(self, asked_by: str) -> None:  # noqa: B027 (some rules have no parameters)
        """Refuse parameters of the rule that it cannot have.

        Args:
            asked_by: who holds the rule, for the message.

        Raises:
            MotesError: the message names the parameter.
        """

    def check_size(self, asked_by: str, size: int) -> None:  # noqa: B027 (most rules take any number)
        """Refuse a number of states that the rule is not made for.

        Raises:
            MotesError: the message says what to use instead.
        """

    @abstractmethod
    def linearized(self, part: Conditional, law: Gaussian, u: Any, t: Any) -> Linearized:
        """Return the linear conditional that stands for another one near a Gaussian.

        Args:
            part: dynamics or sensor, with a mean function and a noise covariance.
            law: the Gaussian.
            u: inputs of the step.
            t: the time.
        """

    def through(self, part: Conditional, law: Gaussian, u: Any, t: Any) -> Gaussian:
        """Return mean and covariance of the value of a conditional: the next state, or the measurement that is to be expected."""
        return self.linearized(part, law, u, t).over(law)

    def measured(self, sensor: Conditional, law: Gaussian, y: jax.Array, u: Any, t: Any) -> Correction:
        """Condition a Gaussian on a measurement `(y,)`; NaN or an infinite variance means not measured."""
        return conditioned(sensor, law, y, self.linearized(sensor, law, u, t))


def conditioned(sensor: Conditional, law: Gaussian, y: jax.Array, near: Linearized, certain: Sequence[int] = ()) -> Correction:
    """Condition a Gaussian on a measurement `(y,)` through the linear conditional that stands for the sensor.

    Of a batch every Gaussian has a covariance of its own, for which rank-one updates are cheaper; they leave out the states that are
    certain, which have no variance.
    """
    innovation, seen = sensor.residual(y, near.prediction), measured_in(y, near.noise)
    if law.center.ndim > 1:
        return law.corrected_in_turn(innovation, [(range(law.center.shape[0]), near.slope)], near.noise, seen, certain)
    return law.corrected(innovation, near.slope, near.noise, seen)._replace(count=jnp.sum(seen))


def check_rule(asked_by: str, rule: Any) -> None:
    """Refuse what is no rule, and a rule with parameters that it cannot have.

    Raises:
        MotesError: the message names the parameter.
    """
    checks.instance(f"{asked_by} rule", rule, Rule, "a rule such as mo.gaussian.Cubature()").check(asked_by)
