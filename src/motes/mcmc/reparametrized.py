"""A kernel in other coordinates (Yu, Meng 2011: interweaving).

For z = to(x) the density is p(back(z)) |d back / dz|. Two uses: moving in the logarithm of what must be positive, and letting one part
follow another, as a path follows its scale: in a `Cycle` with the same kernel in the first coordinates the chain moves along both.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from motes.core import checks, lapack, random
from motes.core.record import record, static
from motes.mcmc.interface import Info, Kernel, LogDensity, Position, State, Wrapper, as_kernel


@record
class Reparametrized(Wrapper):
    """A kernel that moves in other coordinates; density, draws and start stay in the first ones.

    Source: Yu, Meng 2011, To center or not to center: that is not the question; an ancillarity-sufficiency interweaving strategy (ASIS)
    for boosting MCMC efficiency.

    Example:
        >>> kernel = mo.mcmc.Reparametrized(mo.mcmc.RandomWalkMetropolis(1.5), to=jnp.log, back=jnp.exp)
        >>> chains = mo.sample(0, kernel, lambda x: -x[0], jnp.ones(1))
        >>> chains.positions.shape
        (4, 1000, 1)

    Attributes:
        kernel: for positions z.
        to: function from positions x to positions z.
        back: its inverse, differentiable.
        log_volume: function of z, the log of |det d back / dz|. None: by differentiation, at the cost of a determinant each time.
    """

    kernel: Kernel
    to: Callable[[Any], Any] = static()
    back: Callable[[Any], Any] = static()
    log_volume: Callable[[Any], jax.Array] | None = static(default=None)

    def __post_init__(self) -> None:
        """Check the parts.

        Raises:
            MotesError: naming the one that cannot be used.
        """
        as_kernel("Reparametrized kernel", self.kernel)
        for name, value in (("to", self.to), ("back", self.back), ("log_volume", self.log_volume or self.back)):
            if not callable(value):
                checks.refuse(f"Reparametrized {name}", "a function of a position", type(value).__name__)

    def _volume(self, z: Position) -> jax.Array:
        if self.log_volume is not None:
            return self.log_volume(z)
        return lapack.log_volume(self._jacobian(z))

    def _jacobian(self, z: Position) -> jax.Array:
        flat, rebuild = ravel_pytree(z)
        return jax.jacfwd(lambda flat: ravel_pytree(self.back(rebuild(flat)))[0])(flat)

    def _given(self, log_density: LogDensity) -> LogDensity:
        return lambda z: log_density(self.back(z)) + self._volume(z)

    def check(self, key: jax.Array, log_density: LogDensity, position: Position) -> None:
        """Refuse coordinates that do not lead back, or a volume that is not that of the Jacobian, a little away from the start."""
        start, rebuild = ravel_pytree(self.to(position))
        near = start + 0.1 * random.normal(random.child(key, random.NOISE), start.shape, start.dtype)
        z, size = rebuild(near), ravel_pytree(position)[0].shape[0]
        if start.shape[0] != size:
            checks.refuse("Reparametrized to", f"{size} numbers, as many as in the position", start.shape[0])
        again, loose = ravel_pytree(self.to(self.back(z)))[0], 100 * float(jnp.finfo(start.dtype).eps) ** 0.75
        if not np.allclose(again, near, rtol=loose, atol=loose):
            furthest = int(jnp.argmax(jnp.abs(again - near)))
            checks.refuse("Reparametrized back", "the inverse of to", f"{again[furthest]:.6g} for {near[furthest]:.6g} by to(back(z))")
        volume, given = float(lapack.log_volume(jax.jit(self._jacobian)(z))), float(self._volume(z))
        if not np.isclose(volume, given, rtol=1e-3, atol=1e-3):
            checks.refuse("Reparametrized log_volume", f"{volume:.6g} near the start, the log of |det d back / dz|", f"{given:.6g}")
        self.kernel.check(key, self._given(log_density), z)

    def init(self, key: jax.Array, log_density: LogDensity, position: Position) -> State:
        """Start as the kernel does in its coordinates."""
        z = self.to(position)
        inner = self.kernel.init(key, self._given(log_density), z)
        return State(position, inner.log_density - self._volume(z), inner.kernel_state)

    def init_kernel_state(self, log_density: LogDensity, position: Position) -> Any:
        """Return the state of the inner kernel."""
        return self.kernel.init_kernel_state(self._given(log_density), self.to(position))

    def step(self, key: jax.Array, log_density: LogDensity, state: State, t: Any) -> tuple[State, Info]:
        """Make a step of the kernel and come back."""
        z = self.to(state.position)
        there = State(z, state.log_density + self._volume(z), state.kernel_state)
        after, info = self.kernel.step(key, self._given(log_density), there, t)
        return State(self.back(after.position), after.log_density - self._volume(after.position), after.kernel_state), info
