"""Twelve nodes see a target's direction: what does it cost to track it together?

    python examples/sensor_network/run.py [--runs 100] [--rounds 10] [--particles 10000]

All ways run on the same bearings; bytes are those sent in a step. The picture goes to out/sensor_network.png. It takes a minute or two.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
from model import worlds
from network import FIELD, Network
from ways import agreed, alone, in_one_place, summed, together

import motes as mo
from motes.plotting.figures import COLORS, ESTIMATE, INERTIAL, OTHER, TRUE, legend_below, new_figure, tidy

STEPS, FIRST = 60, 5
"""Seconds of a run, and those at its begin that do not count."""


def ways(network: Network, rounds: int, particles: int) -> dict[str, Callable]:
    """Return functions of a key and bearings `(t, nodes)` that give means `(t, nodes, 4)`, by name."""
    center = mo.GaussianParticleFilter(n=particles, on_collapse="predict")
    single = mo.ParticleFilter(n=particles // 5, on_collapse="predict")
    node = mo.UnscentedKalmanFilter()
    return {
        "bearings in one place": lambda key, ys: in_one_place(key, center, network, ys),
        "summed increments": lambda key, ys: together(key, node, network, ys, summed),
        f"consensus, {rounds} rounds": lambda key, ys: together(key, node, network, ys, agreed(network, rounds)),
        "each node alone": lambda key, ys: alone(key, single, network, ys),
    }


def over_runs(way: Callable, ys: jax.Array) -> np.ndarray:
    """Return the means `(runs, t, nodes, 4)` of a way on the bearings of all runs."""
    keys = jax.random.split(jax.random.key(1), len(ys))
    return np.asarray(jax.jit(lambda rows: jax.lax.map(lambda row: way(*row), rows))((keys, ys)))


def sent(network: Network, name: str, seen: np.ndarray, rounds: int) -> tuple[float, float]:
    """Return the bytes that a way sends in a step so that one node knows the target, and so that all do."""
    if name == "bearings in one place":
        return network.bytes_of_bearings(seen)
    if name.startswith("summed"):
        return network.bytes_of_summaries() / 2, network.bytes_of_summaries()
    return (network.bytes_of_consensus(rounds),) * 2 if name.startswith("consensus") else (0, 0)


def compared(network: Network, runs: int, rounds: int, particles: int, steps: int = STEPS):
    """Return a table of all ways, their means by name, true states `(runs, t, 4)` and who saw the target `(runs, t, nodes)`."""
    xs, ys = worlds(network, 0, runs, steps)
    truth, seen, rows, found = np.asarray(xs), ~np.isnan(np.asarray(ys)), [], {}
    for name, way in ways(network, rounds, particles).items():
        found[name] = over_runs(way, ys)
        squared = np.sum((found[name][..., :2] - truth[:, :, None, :2]) ** 2, axis=-1)[:, FIRST:]
        each = np.sqrt(squared.mean(axis=(1, 2)))
        rows.append((name, float(np.sqrt(squared.mean())), float(each.max()), *sent(network, name, seen, rounds)))
    head = ("way", "rms error, m", "worst run", "bytes, one knows", "bytes, all know")
    return mo.io.Table(head, tuple(rows)), found, truth, seen


def picture(network: Network, table: mo.io.Table, found: dict, truth: np.ndarray):
    """Draw the field with one run, and errors over bytes."""
    figure = new_figure(10, 5)
    field, cost = figure.subplots(1, 2, width_ratios=(1.1, 1))
    ends = [network.places[[a, b]].T for a, b in zip(*np.nonzero(np.triu(network.linked)), strict=True)]
    for place, line in enumerate(ends):
        field.plot(*line, color="0.85", linewidth=0.8, zorder=0, label=None if place else "links")
    field.plot(*network.places.T, "s", color=OTHER, markersize=6, label="nodes")
    away = np.linalg.norm(truth[:, -1, :2] - truth[:, 0, :2], axis=-1)
    longest = int(np.argmax(np.where((np.abs(truth[..., :2] - FIELD / 2) < 0.45 * FIELD).all(axis=(1, 2)), away, 0)))
    nearest = int(np.argmin(np.linalg.norm(network.places - truth[longest, truth.shape[1] // 2, :2], axis=-1)))
    field.plot(*truth[longest, :, :2].T, color=TRUE, linewidth=2.4, label="truth")
    field.plot(*found["each node alone"][longest, :, nearest, :2].T, color=COLORS[4], linewidth=1.2, label="the nearest node alone")
    field.plot(*found["summed increments"][longest, :, 0, :2].T, color=ESTIMATE, linewidth=1.2, label="summed increments")
    field.set(xlim=(0, FIELD), ylim=(0, FIELD), aspect="equal", xlabel="m", ylabel="m")
    for place, (way, error, _, _, sent) in enumerate(table.rows):
        if sent:
            cost.plot(sent, error, "o", color=INERTIAL, markersize=7)
            cost.annotate(way, (sent, error), (0, -18 if place % 2 else 9), textcoords="offset points", ha="center", fontsize=9)
    shared = [row[1] for row in table.rows if row[4]]
    cost.set(xscale="log", xlim=(1e2, 2e5), ylim=(0, 1.5 * max(shared)))
    cost.set(xlabel="bytes sent in a step so that all nodes know", ylabel="rms error, m")
    tidy(cost)
    legend_below(figure, field, 5)
    return figure


def main():
    """Run all ways, print the table and draw the picture."""
    parser = argparse.ArgumentParser(description="Tracking by a network of nodes.")
    parser.add_argument("--runs", type=int, default=100, help="targets (100)")
    parser.add_argument("--rounds", type=int, default=10, help="of consensus in a step (10)")
    parser.add_argument("--particles", type=int, default=10_000, help="of the filter with all bearings; a node alone has a fifth (10000)")
    given = parser.parse_args()
    network = Network()
    table, found, truth, seen = compared(network, given.runs, given.rounds, given.particles)
    print(f"{seen.sum(axis=-1).mean():.1f} of {len(network.places)} nodes see the target; {network.linked.sum() // 2} links")
    print(table)
    Path("out").mkdir(exist_ok=True)
    picture(network, table, found, truth).savefig("out/sensor_network.png", dpi=80)
    print("picture: out/sensor_network.png")


if __name__ == "__main__":
    main()
