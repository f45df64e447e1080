"""Run filters, chains and studies over and over, and see whether one of them ever stops for good.

    python benchmarks/soak.py [--minutes 60] [--asleep 60]

A second process watches the first: no progress for so many seconds in which it used no processor time is a stop. Exit code 1 after a stop.
"""

import argparse
import dataclasses
import os
import subprocess
import sys
import time
from pathlib import Path


def works():
    """Give the name of each piece of work and a function that does it with a seed."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    import motes as mo

    a = 0.9 * np.eye(4) + 0.1 * np.eye(4, k=2)
    seen = mo.AdditiveGaussian(lambda x, u, t: jnp.stack([jnp.hypot(x[0], x[1] + 5.0), x[1]]), 0.1 * np.eye(2))
    model = mo.StateSpaceModel(mo.Gaussian(jnp.zeros(4), jnp.eye(4)), mo.LinearGaussian(a, 0.1 * np.eye(4)), seen, tuple("abcd"))
    ys = mo.simulate(0, model, 300)[1]
    filters = {"particle": mo.ParticleFilter(n=1_000), "regularized": mo.RegularizedParticleFilter(n=1_000),
               "marginalized": mo.MarginalizedParticleFilter(n=300), "kalman": mo.ExtendedKalmanFilter()}
    for name, filter in filters.items():
        yield name, lambda seed, filter=filter: jax.block_until_ready(mo.run(seed, filter, model, ys))
    plan = mo.Experiment(model, {name: filters[name] for name in ("particle", "kalman")}, steps=100, runs=16)
    yield "study", lambda seed: mo.study(dataclasses.replace(plan, seed=seed))

    m = mo.mcmc
    most, width = 8, 2

    def count(position):
        k, x = position
        return jnp.where(k >= 1, -0.5 * jnp.sum(jnp.where(jnp.arange(most * width) < width * k, x, 0.0) ** 2), -jnp.inf)

    jumps = m.birth_death(mo.Gaussian(jnp.zeros(width), jnp.eye(width)), most)
    within = m.Mix([m.RandomWalkMetropolis(step * jnp.ones(most * width)) for step in (0.1, 0.3, 1.0)])
    start = m.Configuration(jnp.int32(1), jnp.zeros(most * width))
    jumping = m.Repeat(m.ReversibleJump(jumps, lambda k: width * k, within=within), 10)
    yield "jumps", lambda seed: mo.sample(seed, jumping, count, start, draws=2_000, chains=16, burn_in=0)
    yield "NUTS", lambda seed: mo.sample(seed, m.NUTS(0.3), lambda x: -0.5 * jnp.sum(x**2), jnp.zeros(20), draws=1_000, burn_in=0)


def work(seconds):
    """Do one piece of work after the other and print a line for each."""
    pieces, began, seed = list(works()), time.monotonic(), 0
    while time.monotonic() - began < seconds:
        for name, piece in pieces:
            piece(seed)
            print(f"{time.monotonic() - began:7.0f} s  {name} {seed}", flush=True)
        seed += 1


def watch(minutes, asleep):
    """Have the work done by another process; return whether it stopped."""
    words = [sys.executable, __file__, "--work", str(60 * minutes)]
    process = subprocess.Popen(words)
    stat, ticks = Path(f"/proc/{process.pid}/stat"), os.sysconf("SC_CLK_TCK")
    used, since = 0.0, time.monotonic()
    while process.poll() is None:
        time.sleep(2)
        try:
            fields = stat.read_text().rsplit(")", 1)[1].split()
        except OSError:
            break
        now = (int(fields[11]) + int(fields[12])) / ticks
        if now > used + 0.2:
            used, since = now, time.monotonic()
        elif time.monotonic() - since > asleep:
            process.kill()
            print(f"stopped for good: {used:.0f} s of processor time, none for {asleep:.0f} s")
            return True
    return process.wait() != 0


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--minutes", type=float, default=60.0)
    options.add_argument("--asleep", type=float, default=60.0)
    options.add_argument("--work", type=float, help=argparse.SUPPRESS)
    given = options.parse_args()
    sys.exit(work(given.work) if given.work else int(watch(given.minutes, given.asleep)))
