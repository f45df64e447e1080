"""Measures what a lecture and a survey (Djuric 2004) claim.

Every filter on the growth model, filters told the wrong noise, and two real recordings.

    python papers/survey2004/reproduce.py [growth noise aircraft river] [--runs 1000] [--data FOLDER]

Tables, and the picture of `growth`, go to out/survey2004. All of it takes some eight minutes on two cores. `aircraft` needs a recording:
FOLDER holds aircraft/adsb/belevingsvlucht.csv.
"""

import argparse
import os
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax.numpy as jnp
import numpy as np
from pictures import growth_figure
from recordings import aircraft, river

import motes as mo
from motes.io.archive import provenance
from motes.models.textbook import growth
from motes.studies.tables import accuracy, difference

PARTS = ("growth", "noise", "aircraft", "river")
SEEDS = 20
NUMBERS = (100, 1000, 5000)
STEPS = 100
EXACT = "point mass"
COLUMNS = (
    "filter", "RMSE", "s.e.", "above exact, %", "s.e. of difference", "log-likelihood error", "its s.d.", "runs with a collapse", "us/step",
)  # fmt: skip


def options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Measures what a lecture and a survey (Djuric 2004) claim.")
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; all if none is named")
    parser.add_argument("--runs", type=int, default=1000, help="sets of measurements (1000)")
    parser.add_argument("--data", type=Path, help="folder of recordings, for aircraft")
    parser.add_argument("--out", type=Path, default=Path("out/survey2004"), help="folder of the results")
    given = parser.parse_args()
    for part in given.parts:
        if part not in PARTS:
            parser.error(f"part: expected one of {', '.join(PARTS)}, got {part!r}")
    if given.data is None and "aircraft" in given.parts:
        parser.error("aircraft: expected --data FOLDER with recordings, got none")
    given.parts = given.parts or [part for part in PARTS if given.data or part != "aircraft"]
    return given


def sampled(n: int) -> dict[str, mo.Filter]:
    """Return the filters that draw n numbers a step; collapses are got over, so that all see the same runs."""
    go_on = {"on_collapse": "predict"}
    return {
        "bootstrap": mo.ParticleFilter(n=n, policy=mo.resampling.Always(), **go_on),
        "generic": mo.ParticleFilter(n=n, **go_on),
        "generic, extended Kalman proposal": mo.ParticleFilter(n=n, proposal=mo.ExtendedKalmanProposal(), **go_on),
        "generic, unscented proposal": mo.ParticleFilter(n=n, proposal=mo.UnscentedProposal(), **go_on),
        "auxiliary, dynamics": mo.AuxiliaryParticleFilter(n=n, **go_on),
        "auxiliary, unscented proposal": mo.AuxiliaryParticleFilter(n=n, proposal=mo.UnscentedProposal(), **go_on),
        "regularized": mo.RegularizedParticleFilter(n=n, **go_on),
        "kernel": mo.KalmanParticleKernelFilter(n=n, every=1, **go_on),
        "Gaussian particle": mo.GaussianParticleFilter(n=n, **go_on),
        "Gaussian sum, 10 mixands": mo.GaussianSumParticleFilter(n=n // 10, mixands=10, **go_on),
        "cost-reference": mo.CostReferenceParticleFilter(n=n, q=2, phi=mo.resampling.InverseExcess(delta=1.0), **go_on),
        "ensemble Kalman": mo.EnsembleKalmanFilter(n=n, **go_on),
    }


def unsampled() -> dict[str, mo.Filter]:
    """Return the filters without chance, the exact one first."""
    go_on = {"on_collapse": "predict"}
    return {
        EXACT: mo.PointMassFilter(lower=(-50.0,), upper=(50.0,), nodes=(401,), **go_on),
        "extended Kalman": mo.ExtendedKalmanFilter(**go_on),
        "extended Kalman, iterated": mo.ExtendedKalmanFilter(iterations=5, **go_on),
        "unscented Kalman": mo.UnscentedKalmanFilter(kappa=2.0, beta=0.0, **go_on),
        "cubature Kalman": mo.CubatureKalmanFilter(**go_on),
        "Gauss-Hermite, 10": mo.GaussHermiteFilter(degree=10, **go_on),
    }


def over_growth(runs: int) -> mo.io.Table:
    """Every filter that the growth model allows, beside the exact answer."""
    filters = unsampled() | {f"{name}, {n}": filter for n in NUMBERS for name, filter in sampled(n).items()}
    plan = mo.Experiment(growth(), filters, STEPS, runs)
    found = mo.study(plan)
    ys = plan.drawn(0)[1]
    squared = {name: np.sum((found.estimates[i] - found.truth) ** 2, axis=-1) for i, name in enumerate(found.filters)}
    likelihood = dict(zip(found.filters, found.log_likelihood, strict=True))
    rows = []
    for name, filter in filters.items():
        own, apart = accuracy(squared[name]), difference(squared[name], squared[EXACT])
        off = likelihood[name] - likelihood[EXACT]
        place = list(found.filters).index(name)
        told = (float(off.mean()), float(off.std(ddof=1))) if np.isfinite(off).all() else (None, None)
        collapsed = int((found.collapsed[place] >= 0).sum())
        above = 100 * (own.rmse / accuracy(squared[EXACT]).rmse - 1)
        rows.append(
            (name, own.rmse, own.error, above, apart.error, *told, collapsed, 1e6 * mo.costs.seconds_per_step(filter, plan.model, ys))
        )
    return mo.io.Table(COLUMNS, tuple(rows))


def beacons(noise: mo.StudentT | None) -> mo.StateSpaceModel:
    """A walker who hears three beacons: ranges with the noise given, or with the Gaussian that filters are told of."""
    places = jnp.array([[0.0, 0.0], [10.0, 0.0], [3.0, 9.0]])

    def ranges(x: jnp.ndarray, u: None, t: jnp.ndarray) -> jnp.ndarray:
        return jnp.sqrt(jnp.sum((x[:2] - places) ** 2, axis=1) + 1e-6)

    step = jnp.array([[1.0, 0, 0.5, 0], [0, 1, 0, 0.5], [0, 0, 0.95, 0], [0, 0, 0, 0.95]])
    dynamics = mo.LinearGaussian(step, jnp.diag(jnp.array([0.02, 0.02, 0.05, 0.05])))
    sensor = mo.AdditiveGaussian(ranges, 0.3**2 * jnp.eye(3)) if noise is None else mo.AdditiveNoise(ranges, noise)
    initial = mo.Gaussian(jnp.array([4.0, 3.0, 0.2, 0.1]), jnp.diag(jnp.array([1.0, 1.0, 0.2, 0.2])))
    return mo.StateSpaceModel(initial, dynamics, sensor, ("east", "north", "v_east", "v_north"))


def by_costs(q: int, delta: float, selection: str = "global") -> mo.Filter:
    """Return a filter that needs no law; delta is about what the noise of one measurement costs."""
    return mo.CostReferenceParticleFilter(n=1000, q=q, phi=mo.resampling.InverseExcess(delta=delta), selection=selection)


def wrong_noise(runs: int) -> mo.io.Table:
    """Filters that take the heavy tails of the ranges for Gaussian, beside those that need no law, and one that knows it."""
    rows = []
    for degrees in (1.2, 2.0, 4.0):
        world, told = beacons(mo.StudentT([0.3] * 3, degrees)), beacons(None)
        filters = {
            "bootstrap, told Gaussian": (mo.ParticleFilter(n=1000, on_collapse="predict"), told),
            "extended Kalman, told Gaussian": (mo.ExtendedKalmanFilter(on_collapse="predict"), told),
            "cost-reference, q = 1": (by_costs(1, 0.3), told),
            "cost-reference, q = 2": (by_costs(2, 0.1), told),
            "cost-reference, q = 1, local": (by_costs(1, 0.3, "local"), told),
            "bootstrap, told the truth": mo.ParticleFilter(n=1000, on_collapse="predict"),
        }
        found = mo.study(mo.Experiment(world, filters, STEPS, runs, blocks={"position": ("east", "north")}))
        squared = np.sum((found.estimates - found.truth)[..., :2] ** 2, axis=-1)
        for i, name in enumerate(found.filters):
            own, apart = accuracy(squared[i]), difference(squared[i], squared[0])
            median = float(np.median(np.sqrt(squared[i].mean(axis=1))))
            rows.append((f"t with {degrees:g} degrees", name, own.rmse, own.error, median, apart.rmse, apart.error))
    return mo.io.Table(("noise", "filter", "RMSE, m", "s.e.", "median run, m", "to the first", "s.e. of it"), tuple(rows))


def main() -> None:
    """Measure what was asked for."""
    given = options()
    given.out.mkdir(parents=True, exist_ok=True)
    print(", ".join(f"{key.removeprefix('motes_')} {value}" for key, value in provenance().items()))
    tables = {
        "growth": lambda: over_growth(given.runs),
        "noise": lambda: wrong_noise(given.runs),
        "aircraft": lambda: aircraft(given.data, SEEDS),
        "river": lambda: river(SEEDS),
    }
    for part in given.parts:
        found = tables[part]()
        print(f"\n{part}\n{found}", flush=True)
        found.save(given.out / f"{part}.csv")
        found.save(given.out / f"{part}.md")
        if part == "growth":
            growth_figure(found, NUMBERS).savefig(given.out / "growth.png")


if __name__ == "__main__":
    main()
