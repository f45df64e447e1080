"""What was asked of us, as ratios within one run: float32 where nothing else is said, two cores."""

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
    steps: int = 100


MOTES, JAX = "motes", "motes (JAX)"
USUAL = "particles (BLAS threads as set up)"
"""What a user of particles gets; where that is slower than one thread, both ratios are shown."""

TARGETS = (
    Target("bootstrap", "radar", 200_000, "particles", JAX, 7),
    Target("bootstrap", "radar", 200_000, USUAL, JAX, 7),
    Target("bootstrap", "radar", 200_000, "particles", MOTES, 25),
    Target("bootstrap", "radar", 200_000, "smcx", MOTES, 18),
    Target("bootstrap", "radar", 200_000, "cuthbert", MOTES, 18),
    Target("bootstrap", "radar", 200_000, MOTES, "C++ yardstick", 1.4, most=True),
    Target("bootstrap", "radar", 200_000, f"{JAX}, float64", f"{MOTES}, float64", 5),
    Target("bootstrap", "radar", 2_000, "particles", MOTES, 12),
    Target("bootstrap", "radar", 2_000, MOTES, "C++ yardstick", 2.0, most=True),
    Target("bootstrap", "line", 2_000, MOTES, "C++ yardstick", 1.3, most=True),
    Target("bootstrap", "line", 100_000, "particles", JAX, 1.8),
    Target("bootstrap", "line", 100_000, "particles", MOTES, 4),
    Target("bootstrap", "line", 100_000, "smcx", MOTES, 8),
    Target("bootstrap", "line", 100_000, "cuthbert", MOTES, 8),
    Target("models", "pendulums", 100_000, JAX, MOTES, 10, steps=50),
    Target("models", "terrain, 9 states, marginalized", 15_000, JAX, MOTES, 5, steps=400),
    Target("marginalized", "turning", 20_000, "vmap of jnp.linalg", JAX, 10),
    Target("marginalized", "turning", 20_000, "vmap of jnp.linalg", MOTES, 10),
    Target("many", "radar", 2_000, "particles", JAX, 10),
    Target("many", "radar", 2_000, "particles", MOTES, 10),
    Target("kalman", "track", 1, MOTES, "dynamax", 1.0, most=True, steps=100_000),
    Target("start", "empty cache", 2_000, MOTES, JAX, 1.5, most=True),
    Target("blocks", "normal", 100_000, "jax.numpy", "motes.core", 3, size=1, steps=1),
    Target("blocks", "normal", 1_000_000, "jax.numpy", "motes.core", 3, size=1, steps=1),
    *(
        Target("blocks", operation, 20_000, "motes.core", "written out by hand", 1.5, True, size, 1)
        for operation in ("product", "cholesky", "solve_lower", "sandwich")
        for size in (4, 6, 15)
    ),
)
SLOPE = (0.9, 1.1)
"""Exponent of time against particles (1e4 to 1e6) and against steps (100 to 10 000)."""
