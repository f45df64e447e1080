"""Times every filter on one model and sets its cost beside that of its operations; writes FILTERS.md beside this file.

    python benchmarks/filters.py

The bootstrap filter is the measure: what would the operations of a filter take at the bootstrap filter's speed? Operations are those that
the compiler counts in a step of the compiled program, each transcendental one as ten. It takes some three minutes; leave the machine alone.
"""

import os

os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax
import jax.numpy as jnp
from pages import told, write_page

import motes as mo
from motes.core import random
from motes.filters.setup import setup
from motes.models.textbook import radar_tracking

N, STEPS, TURNS = 2000, 60, 2
TRANSCENDENTAL = 10
LIMIT = 2.0
COLUMNS = ("filter", "ns per particle and step", "operations", "time over that of its operations", f"above {LIMIT:g}")


def sampled():
    """Return the filters with n particles, the bootstrap filter first; collapses do not stop the clock."""
    go_on = {"on_collapse": "predict"}
    return {
        "bootstrap": mo.ParticleFilter(n=N, policy=mo.resampling.Always(), **go_on),
        "generic": mo.ParticleFilter(n=N, **go_on),
        "extended Kalman proposal": mo.ParticleFilter(n=N, proposal=mo.ExtendedKalmanProposal(), **go_on),
        "unscented proposal": mo.ParticleFilter(n=N, proposal=mo.UnscentedProposal(), **go_on),
        "auxiliary": mo.AuxiliaryParticleFilter(n=N, **go_on),
        "auxiliary, unscented proposal": mo.AuxiliaryParticleFilter(n=N, proposal=mo.UnscentedProposal(), **go_on),
        "marginalized": mo.MarginalizedParticleFilter(n=N, **go_on),
        "regularized": mo.RegularizedParticleFilter(n=N, **go_on),
        "kernel": mo.KalmanParticleKernelFilter(n=N, **go_on),
        "Gaussian particle": mo.GaussianParticleFilter(n=N, **go_on),
        "Gaussian sum, 10 mixands": mo.GaussianSumParticleFilter(n=N // 10, mixands=10, **go_on),
        "cost-reference": mo.CostReferenceParticleFilter(n=N, **go_on),
        "ensemble Kalman": mo.EnsembleKalmanFilter(n=N, **go_on),
        "jump-Markov, one mode": mo.JumpMarkovFilter(n=N, **go_on),
        "jump-Markov, positions drawn": mo.JumpMarkovFilter(n=N, sampled=("px", "py"), **go_on),
    }


def operations(filter, model, y):
    """Count the operations of one step."""
    key = random.as_key(0)

    def step(carry, y):
        return setup(key, filter, model, None, y).step(carry, y, None)

    begun = jax.jit(lambda y: setup(key, filter, model, None, y).begin(y, None)[0])(y)
    counted = jax.jit(step).lower(begun, y).compile().cost_analysis()
    return counted["flops"] + TRANSCENDENTAL * counted.get("transcendentals", 0.0)


def main():
    """Measure and write the table."""
    model = radar_tracking()
    ys = jnp.asarray(mo.simulate(0, model, STEPS)[1])
    filters = sampled()
    times = {name: [] for name in filters}
    for turn in range(TURNS):
        for name, filter in filters.items():
            times[name].append(mo.costs.seconds_per_step(filter, model, ys))
        print(f"turn {turn + 1} of {TURNS}", flush=True)
    counts = {name: operations(filter, model, ys[0]) for name, filter in filters.items()}
    rows = []
    for name in filters:
        cost = min(times[name]) / N * 1e9
        expected = min(times["bootstrap"]) / N * 1e9 * counts[name] / counts["bootstrap"]
        rows.append((name, cost, counts[name] / N, cost / expected, "" if cost <= LIMIT * expected else "yes"))
    words = f"Radar model of six states, n = {N}, JAX engine. {told(__doc__)}"
    write_page("FILTERS", "Every filter", words, mo.io.Table(COLUMNS, tuple(rows)))


if __name__ == "__main__":
    main()
