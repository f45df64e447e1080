"""What is measured: the engines, and the tasks of each case."""

from dataclasses import dataclass, field

OURS = ("motes", "motes (JAX)", "motes (native)")
"""Motes as it comes, which chooses native kernels or JAX by itself, and each of the two alone."""


@dataclass(frozen=True)
class Engine:
    """Where an engine lives (peers/MODULE.py), the package it comes from, the options of its `prepare`, and variables of its process."""

    module: str
    package: str
    options: dict = field(default_factory=dict)
    environment: dict = field(default_factory=dict)


ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1"}
"""The small matrix products of NumPy libraries run up to three times faster so; beside it the setting that users get by themselves."""


ENGINES = {
    "motes": Engine("ours", "motes", {"engine": "auto"}),
    "motes (JAX)": Engine("ours", "motes", {"engine": "jax"}),
    "motes (native)": Engine("ours", "motes", {"engine": "native"}),
    "motes, mean and covariance": Engine("ours", "motes", {"engine": "auto", "keep": "moments"}),
    "motes (JAX), mean and covariance": Engine("ours", "motes", {"engine": "jax", "keep": "moments"}),
    "motes, float64": Engine("ours", "motes", {"engine": "auto"}, {"JAX_ENABLE_X64": "1"}),
    "motes (JAX), float64": Engine("ours", "motes", {"engine": "jax"}, {"JAX_ENABLE_X64": "1"}),
    "particles": Engine("particles_peer", "particles", environment=ONE_THREAD),
    "particles (BLAS threads as set up)": Engine("particles_peer", "particles"),
    "smcx": Engine("smcx_peer", "smcx"),
    "cuthbert": Engine("cuthbert_peer", "cuthbert"),
    "filterpy": Engine("filterpy_peer", "filterpy", environment=ONE_THREAD),
    "dynamax": Engine("dynamax_peer", "dynamax"),
    "stonesoup": Engine("stonesoup_peer", "stonesoup", environment=ONE_THREAD),
    "vmap of jnp.linalg": Engine("vmapped", ""),
    "C++ yardstick": Engine("yardstick", ""),
    "motes.core": Engine("blocks", "motes", {"way": "core"}),
    "jax.numpy": Engine("blocks", "", {"way": "library"}),
    "written out by hand": Engine("blocks", "", {"way": "hand"}),
}
KEEPING = tuple(name for name in ENGINES if "covariance" in name)
DOUBLE = tuple(name for name in ENGINES if "float64" in name)
PARTICLE = (
    *(*OURS, *KEEPING, "particles", "particles (BLAS threads as set up)"),
    *("smcx", "cuthbert", "stonesoup", "filterpy", "dynamax", "C++ yardstick"),
)


@dataclass(frozen=True)
class Row:
    """One task: its size (`n` particles, `steps`, `runs`) is what nanoseconds are divided by."""

    kind: str
    model: str
    n: int
    steps: int
    engines: tuple[str, ...]
    runs: int = 1
    more: dict = field(default_factory=dict)


def bootstrap(quick):
    """Bootstrap filter: line and radar."""
    sizes = (2_000,) if quick else (2_000, 20_000, 100_000, 200_000, 1_000_000)
    rows = [(model, n) for model in ("line", "radar") for n in sizes if (model, n) != ("radar", 100_000)]
    # the slowest of all would take as long at a million as everything else together
    quickest = tuple(name for name in PARTICLE if name not in ("stonesoup", "filterpy", "dynamax"))
    engines = {n: PARTICLE if n < 1_000_000 else quickest for n in sizes}
    return [Row("bootstrap", model, n, 100, engines[n] + (DOUBLE if (model, n) == ("radar", 200_000) else ())) for model, n in rows]


def models(quick):
    """Models as users have them: substeps by Runge and Kutta and a table; terrain, 9 and 15 states."""
    n = 2_000 if quick else 100_000
    rows = [Row("bootstrap", "pendulums", n, 50, OURS)]
    for states in (9, 15):
        for filter, n in (("marginalized", 15_000), ("kernel", 2_500)):
            rows.append(Row("terrain", f"terrain, {states} states, {filter}", n, 400, OURS[:2], more={"filter": filter, "states": states}))
    return rows[: 2 if quick else None]


def marginalized(quick):
    """Marginalized filter: one shared Riccati (radar), one per particle (turning)."""
    engines = (*OURS, "vmap of jnp.linalg")
    sizes = {"radar": (2_000, 20_000, 200_000), "turning": (2_000, 20_000)}
    return [Row("marginalized", model, n, 100, engines) for model in sizes for n in sizes[model][: 1 if quick else None]]


def many(quick):
    """Many runs at once of a small filter."""
    return [Row("many", "radar", 2_000, 100, (*OURS, "particles", "smcx", "cuthbert"), runs=5 if quick else 100)]


def kalman(quick):
    """Kalman filter over a long record; the slow peers take a shorter one, which says what a step costs all the same."""
    long, short = (2_000, 500) if quick else (100_000, 10_000)
    slow = ("filterpy", "particles", "stonesoup")
    return [
        Row("kalman", "track", 1, long, ("motes", "smcx", "cuthbert", "dynamax")),
        Row("kalman", "track", 1, short, ("motes", *slow)),
    ]


def scaling(quick):
    """Cost against the number of particles, and of steps."""
    own = OURS[1:]
    engines = (*own, "particles")
    sizes = (10_000, 30_000) if quick else (10_000, 30_000, 100_000, 300_000, 1_000_000)
    lengths = (10, 30) if quick else (100, 1_000, 10_000)
    return [Row("bootstrap", "radar", n, 100, engines) for n in sizes] + [Row("bootstrap", "circling", 20_000, t, own) for t in lengths]


def blocks(quick):
    """Building blocks: normal numbers and small-matrix algebra."""
    engines = ("motes.core", "jax.numpy", "written out by hand")
    lengths, sizes = ((100_000,), (4,)) if quick else ((100_000, 1_000_000), (4, 6, 15))
    tasks = [("normal", n, 1, engines[:2]) for n in lengths]
    tasks += [(operation, 20_000, size, engines) for operation in ("product", "cholesky", "solve_lower", "sandwich") for size in sizes]
    return [Row("block", operation, n, 1, who, runs=20, more={"size": size}) for operation, n, size, who in tasks]


def start(quick):
    """Cold start: a fresh process, without and with a filled compilation cache, and a model built anew in the same process."""
    return [Row("bootstrap", "radar", 2_000, 100, (*OURS, "particles", "smcx", "cuthbert"))]


CASES = {case.__name__: case for case in (bootstrap, models, marginalized, many, kalman, scaling, start, blocks)}
