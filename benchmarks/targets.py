"""What was asked of us, as ratios within one run: float32, two cores."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Target:
    """Engine `slow` takes at least `factor` times as long as `fast` on one row of a case; at most, where `most` is set."""

    case: str
    model: str
    n: int
    slow: str
    fast: str
    factor: float
    most: bool = False
    size: int = 0


JAX, NATIVE = "motes (JAX)", "motes (native)"
USUAL = "particles (BLAS threads as set up)"
"""What a user of particles gets; where that is slower than one thread, both ratios are shown."""

TARGETS = (
    Target("bootstrap", "radar", 200_000, "particles", JAX, 7),
    Target("bootstrap", "radar", 200_000, USUAL, JAX, 7),
    Target("bootstrap", "radar", 200_000, "particles", NATIVE, 18),
    Target("bootstrap", "radar", 200_000, "smcx", NATIVE, 18),
    Target("bootstrap", "radar", 200_000, "cuthbert", NATIVE, 18),
    Target("bootstrap", "radar", 200_000, NATIVE, "C++ yardstick", 2.5, most=True),
    Target("bootstrap", "radar", 2_000, "particles", NATIVE, 12),
    Target("bootstrap", "line", 100_000, "particles", JAX, 1.8),
    Target("bootstrap", "line", 100_000, "particles", NATIVE, 4),
    Target("bootstrap", "line", 100_000, "smcx", NATIVE, 8),
    Target("bootstrap", "line", 100_000, "cuthbert", NATIVE, 8),
    Target("marginalized", "turning", 20_000, "vmap of jnp.linalg", JAX, 10),
    Target("marginalized", "turning", 20_000, "vmap of jnp.linalg", NATIVE, 10),
    Target("many", "radar", 2_000, "particles", JAX, 10),
    Target("many", "radar", 2_000, "particles", NATIVE, 10),
    Target("blocks", "normal", 100_000, "jax.numpy", "motes.core", 3, size=1),
    Target("blocks", "normal", 1_000_000, "jax.numpy", "motes.core", 3, size=1),
    *(
        Target("blocks", operation, 20_000, "motes.core", "written out by hand", 1.5, True, size)
        for operation in ("product", "cholesky", "solve_lower", "sandwich")
        for size in (4, 6, 15)
    ),
)
SLOPE = (0.9, 1.1)
"""Exponent of time against particles (1e4 to 1e6) and against steps (100 to 10 000)."""
