"""Times a stream on the radar model step by step, and watches its memory; run on an idle machine.

    python benchmarks/streaming.py [STEPS]

A step is `predict()` and `update(y)`, until the new law is there. Memory is what the process holds after the first tenth of the steps and
at the end.
"""

import sys
import time

import jax
import numpy as np
from peers.ours import radar_model

import motes as mo

PARTICLES = 2_000


def resident():
    """Bytes of memory that the process holds now."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096


def main(steps):
    model = radar_model()
    ys = np.asarray(mo.simulate(0, model, 200)[1])
    stream = mo.stream(0, mo.ParticleFilter(n=PARTICLES, on_collapse="predict"), model)
    stream.update(ys[0])
    seconds = np.full(steps, np.nan)
    for i in range(-2, steps):
        begun = time.perf_counter()
        stream.predict()
        stream.update(ys[i % len(ys)])
        jax.block_until_ready(stream.state)
        if i >= 0:
            seconds[i] = time.perf_counter() - begun
        if i == steps // 10:
            early = resident()
    median, late, worst = (1e3 * value for value in (*np.quantile(seconds, [0.5, 0.99]), seconds.max()))
    print(f"stream, bootstrap, radar, n = {PARTICLES}, {steps} steps, ms a step: median {median:.3f}, p99 {late:.3f}, max {worst:.2f}")
    print(f"memory: {early / 2**20:.1f} MiB after {steps // 10} steps, {(resident() - early) / 2**20:+.1f} MiB at the end")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100_000)
