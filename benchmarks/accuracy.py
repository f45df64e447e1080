"""Runs the two jobs over many seeds and prints how accurate they are.

    python benchmarks/accuracy.py terrain [SEEDS]
    python benchmarks/accuracy.py robot Plaza1_.mat [SEEDS]
"""

import sys
import time

import jax
import numpy as np

import motes as mo
from motes.applications.robot import scenario as robot
from motes.applications.terrain import scenario as terrain


def fly(seeds, n=15_000):
    """Final horizontal error of the marginalized filter over simulated flights."""
    final = []
    for seed in range(seeds):
        flight = terrain.simulated(seed)
        history = mo.run(seed, mo.MarginalizedParticleFilter(n=n, on_collapse="predict"), flight.model, flight.ys, flight.inputs)
        final.append(terrain.score(history, flight).final)
    final = np.array(final)
    print(f"terrain, n = {n}, {seeds} seeds: {int((final > terrain.LOST).sum())} lost, median final error {np.median(final):.1f} m")
    print("final errors, m:", np.round(np.sort(final), 1).tolist())


def drive(path, seeds, n=1_000):
    """RMS position error and scale of the range-only robot, both odometries."""
    for odometry in ("recorded", "drifting"):
        job = robot.loaded(path, odometry)
        filter = mo.MarginalizedParticleFilter(n=n, linear=("scale", "offset"), on_collapse="predict")
        scores, started = [], time.perf_counter()
        for seed in range(seeds):
            scores.append(jax.tree.map(float, robot.score(mo.run(seed, filter, job.model, job.ys, job.inputs), job)))
        rms, scale = (np.array([getattr(score, name) for score in scores]) for name in ("rms", "scale"))
        seconds = (time.perf_counter() - started) / seeds
        print(
            f"robot, {odometry} odometry, n = {n}, {seeds} seeds: "
            f"RMS {rms.mean():.3f} m (sd {rms.std(ddof=1):.3f}, worst {rms.max():.3f}), "
            f"scale {scale.mean():.4f} ({scale.min():.4f} to {scale.max():.4f}), {seconds:.1f} s a run"
        )


if __name__ == "__main__":
    words = sys.argv[1:]
    if words[:1] == ["terrain"]:
        fly(int(words[1]) if len(words) > 1 else 20)
    elif words[:1] == ["robot"] and len(words) > 1:
        drive(words[1], int(words[2]) if len(words) > 2 else 20)
    else:
        sys.exit(__doc__)
