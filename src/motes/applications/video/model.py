"""The target: where its middle is (pixels of the clip) and how large it is, told by a product of cues.

Three states: x and y of the middle of the box, and the logarithm of its size, the geometric mean of its sides in pixels. All three walk at
random, in steps that grow with the box. log p of a picture is the sum of -50 D^2 by colour, 10 times the score of what was learned, and 5
times the contrast of what moves. What was learned comes as `u["memory"]` (see `learning.py`), and with it what does not change of the box,
its width over its height: so all boxes share their compiled programs.
"""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp

from motes.applications.video.boosting import Ensemble
from motes.applications.video.colour import distance, histograms
from motes.applications.video.features import moving, pool, values
from motes.core.record import record, static
from motes.filters.adapting import MEMORY
from motes.laws.conditional import AdditiveGaussian
from motes.laws.custom import Custom
from motes.laws.gaussian import Gaussian
from motes.models.state_space import StateSpaceModel

STATES = ("x", "y", "log_size")
PACE, GROWTH = 0.15, 0.03
"""Standard deviations of a step: of the middle beside the box, and of the logarithm of the size."""
COLOUR, LEARNED, MOTION = 50.0, 10.0, 5.0
"""What each cue counts for, in nats."""
CUES = ("colour", "learned", "motion")


@record
class Look:
    """How a picture is looked at.

    Attributes:
        stride: of the pixels that are looked at.
        cues: those that count, of `CUES`.
    """

    stride: int = static()
    cues: tuple[str, ...] = static(default=CUES)

    def boxes(self, X: jax.Array, memory: Any) -> jax.Array:
        """Return left, top, right and bottom `(4, m)` of states `(3, m)`, in pixels that are looked at."""
        reach = sides(X[2], memory) / 2
        return jnp.concatenate([X[:2] - reach, X[:2] + reach]) / self.stride

    def score(self, y: Any, X: jax.Array, memory: Any) -> jax.Array:
        """Return from -1 to 1 how much states look like what was learned, `(m,)`."""
        ensemble = Ensemble.of(memory)
        return ensemble.score(values(y["sums"], self.boxes(X, memory), pool().some(ensemble.chosen)))

    def log_likelihood(self, y: Any, X: jax.Array, memory: Any) -> jax.Array:
        """Return the log density of a picture by all cues, but for a constant, `(m,)`."""
        boxes, found = self.boxes(X, memory), jnp.zeros(X.shape[1], X.dtype)
        if "colour" in self.cues:
            found -= COLOUR * distance(histograms(y["bins"], boxes), memory["colour"])
        if "learned" in self.cues:
            found += LEARNED * self.score(y, X, memory)
        if "motion" in self.cues:
            found += MOTION * moving(y["sums"], boxes)
        return found


def sides(log_size: jax.Array, memory: Any) -> jax.Array:
    """Return width and height of boxes in pixels of the clip, `(2, ...)`, by the logarithms of their sizes."""
    return jnp.stack([jnp.exp(log_size) * memory["aspect"] ** 0.5, jnp.exp(log_size) / memory["aspect"] ** 0.5])


def followed(look: Look, start: jax.Array) -> StateSpaceModel:
    """Return the model of a target that is first seen in the state `start` `(3,)`."""
    place = jnp.diag(jnp.array([0.02, 0.02, 0.01]) * jnp.exp(start[2]) ** jnp.array([1, 1, 0])) ** 2
    return StateSpaceModel(Gaussian(start, place), *_conditionals(look), STATES)


@cache
def _conditionals(look: Look) -> tuple[AdditiveGaussian, Custom]:
    """Return dynamics and sensor; the same for equal looks, so that nothing is compiled twice."""

    def spread(x: jax.Array, u: Any, t: Any) -> jax.Array:
        pace = PACE * jnp.exp(x[2])
        return jnp.diag(jnp.stack([pace**2, pace**2, jnp.full((), GROWTH**2, x.dtype)]))

    def density(y: Any, X: jax.Array, u: Any, t: Any) -> jax.Array:
        # beside what is usual of late, so that the evidence tells a target that is lost from one that looks different by and by
        return look.log_likelihood(y, X, u[MEMORY]) - u[MEMORY]["usual"]

    return AdditiveGaussian(lambda x, u, t: x, spread), Custom(log_prob=density, batched=True)
