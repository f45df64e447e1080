"""Draws the pictures of the README, of the gallery, of each method and of the papers: python docs/pictures.py [NAME ...]."""

import io
import re
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from pages import methods, parts
from PIL import Image

import motes as mo
from motes.applications.terrain import scenario
from motes.applications.terrain.model import corrected
from motes.applications.terrain.pictures import ground
from motes.applications.terrain.settings import Prior, Route
from motes.plotting.figures import ESTIMATE, TRUE, WORDS, legend_below, new_figure, tidy

HERE = Path(__file__).parent
MOMENTS = (0, 4, 12, 60)
"""Fixes that the picture of the README shows."""


def cloud():
    """Draw a cloud of particles that finds an aircraft over the relief of `motes demo`, which it knows to some kilometers at first."""
    route, prior = Route(north=13e3, east=9e3, fixes=MOMENTS[-1] + 1), Prior(horizontal_position=2_000)
    flight = scenario.simulated(1, route=route, prior=prior)
    history = mo.run(1, mo.MarginalizedParticleFilter(n=15_000), flight.model, flight.ys, flight.inputs, keep=mo.keep.laws)
    figure = new_figure(10, 3)
    for place, step in enumerate(MOMENTS):
        law, inertial = (jax.tree.map(lambda leaf, step=step: leaf[step], tree) for tree in (history.law, flight.inputs))
        north, east, _ = corrected(inertial, law.sample(jax.random.key(step), 3_000).T, history.names)
        axes = figure.add_subplot(1, len(MOMENTS), place + 1)
        ground(axes, flight.terrain)
        axes.scatter(east / 1e3, north / 1e3, s=4, color="#b00020", alpha=0.6, linewidths=0)
        east, north = flight.truth[step, ::-1] / 1e3
        axes.plot(east, north, "o", markersize=11, markerfacecolor="none", markeredgewidth=2, color=TRUE)
        axes.set(xlim=(3, 19), ylim=(7, 23), xticks=[], yticks=[])
        axes.set_title(f"after {flight.seconds[step]:.0f} s", **WORDS)
    return figure


INSTEAD = {
    "JPDAParticleFilter": """
one = mo.Cluttered(mo.AdditiveGaussian(lambda x, u, t: x[:1], [[0.1]]), 0.9, clutter=(1.0, mo.Uniform([-10.0], [10.0])), plots=12)
both = mo.laws.SeveralTargets(one, (("a", "v_a"), ("b", "v_b")))
A, Q = jnp.kron(jnp.eye(2), jnp.array([[1.0, 1.0], [0.0, 1.0]])), jnp.kron(jnp.eye(2), jnp.array([[1e-3, 0.0], [0.0, 1e-4]]))
start = mo.Gaussian(jnp.array([-5.0, 0.2, 5.0, -0.2]), jnp.diag(jnp.array([0.1, 1e-3, 0.1, 1e-3])))
model = mo.StateSpaceModel(start, mo.LinearGaussian(A, Q), both, ("a", "v_a", "b", "v_b"))
xs, ys = mo.simulate(1, model, 50)
found = mo.run(0, mo.JPDAParticleFilter(n=500), model, ys)
""",
    "Viterbi": """
none = [[0.0]]
parts = [mo.StateSpaceModel(mo.Gaussian([0.0], none), mo.LinearGaussian([[1.0]], none),
                            mo.AdditiveGaussian(lambda x, u, t, level=level: x + level, [[0.5]]), ("state",)) for level in (0.0, 1.5)]
model = mo.JumpMarkovModel([0.5, 0.5], [[0.95, 0.05], [0.1, 0.9]], parts)
xs, ys = mo.simulate(3, model, 50)
history = mo.run(0, mo.InteractingMultipleModel(), model, ys, keep=mo.keep.laws)
found = mo.smooth(1, mo.smoothers.Viterbi(), model, history)
xs = xs[:, -1:]
""",
}
"""Code in place of the examples that are too short for a picture; it leaves `xs` and `found`."""


def example(name, cls):
    """Run the example of a method, and return the true states, what was found, and the names of the states."""
    code = INSTEAD.get(name)
    if code is None:
        shown = re.findall(r"^(?:>>>|\.\.\.) (.*)$", parts(cls)[2], re.M)
        code = "\n".join([*shown[:-1], "found = " + re.match(r"(.*\))\.(?:mean|state|info|modes)\b", shown[-1])[1]])
    names = {"mo": mo, "jax": jax, "jnp": jnp}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mo.MotesWarning)
        exec(compile(code, name, "exec"), names)  # noqa: S102 (what our own classes show)
    return np.asarray(names["xs"]), names["found"], getattr(names["model"], "names", ("x",))


def picture(name, cls):
    """Draw the first state of a method's example with the truth, or its error where that is too small to be seen beside the truth."""
    xs, found, names = example(name, cls)
    figure = new_figure(7, 2.5)
    axes = figure.add_subplot()
    tidy(axes)
    if name == "Viterbi":
        axes.step(range(len(xs)), xs[:, 0], where="mid", color=TRUE, linewidth=3, alpha=0.4, label="true mode")
        axes.step(range(len(xs)), found.modes[:, 0], where="mid", color=ESTIMATE, linewidth=1.5, label="most probable path")
    else:
        spread = 2 * np.sqrt(np.maximum(np.diagonal(np.asarray(found.cov), axis1=1, axis2=2), 0))
        targets = (0, 2) if name == "JPDAParticleFilter" else (0,)
        for state in targets:
            against_truth(axes, xs[:, state], np.asarray(found.mean)[:, state], spread[:, state], names[state], len(targets) > 1)
    axes.set(xlabel="step", xlim=(0, len(found.mean) - 1))
    legend_below(figure, axes, 3)
    return figure


def against_truth(axes, x, mean, spread, label, several):
    """Draw one state."""
    steps, x, first = np.arange(len(mean)), x[: len(mean)], not axes.lines
    look = {"color": ESTIMATE, "alpha": 0.25, "linewidth": 0, "label": "two standard deviations" if first else None}
    if np.median(spread) > 0.03 * np.ptp(x) or several:
        axes.plot(steps, x, color=TRUE, linewidth=1, label="true" if first else None)
        axes.plot(steps, mean, color=ESTIMATE, linewidth=1.5, label="mean" if first else None)
        axes.fill_between(steps, mean - spread, mean + spread, **look)
        axes.set_ylabel("" if several else label, **WORDS)
    else:
        axes.plot(steps, mean - x, color=ESTIMATE, linewidth=1.5, label="mean less truth")
        axes.fill_between(steps, -spread, spread, **look)
        axes.set_ylabel(f"error of {label}", **WORDS)


def save(figure, path, dpi=100):
    """Write a figure as a small picture."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=dpi)
    shrink(file, path)


def shrink(file, path, widest=1_000):
    """Write a picture with few colors, and no wider than so many points."""
    found = Image.open(file).convert("RGB")
    found.thumbnail((widest, 4 * widest))
    found.quantize(256).save(path, optimize=True)


DEMOS = {"terrain": "map.png", "robot": "robot.png", "laser": "laser.png", "slam": "map.png", "aircraft": "track.png", "notch": "track.png",
         "video": "strip.png", "modes": "messages.png"}  # fmt: skip
"""The picture of each demonstration that the gallery shows."""


def demo(name):
    """Run a demonstration, and take its picture."""
    with tempfile.TemporaryDirectory() as out:
        subprocess.run([sys.executable, "-m", "motes.cli.main", "demo", name, "--out", out], check=True, stdout=subprocess.DEVNULL)
        shrink(Path(out) / DEMOS[name], HERE / "gallery" / f"{name}.png", 900)


PAPERS = {
    "dahia2004": ("nine", ["9_states_position_noise_0.5"]),
    "karlsson2004": ("figure1 tracks", ["figure1", "tracks"]),
    "survey2004": ("growth", ["growth"]),
}
"""Which parts of a paper are reproduced for its page, and their pictures that it shows."""


def paper(name):
    """Reproduce parts of a paper, which takes minutes, and take the pictures."""
    folder = HERE.parent / "papers" / name
    parts, shown = PAPERS[name]
    with tempfile.TemporaryDirectory() as out:
        subprocess.run([sys.executable, folder / "reproduce.py", *parts.split(), "--out", out], check=True, stdout=subprocess.DEVNULL)
        for one in shown:
            shrink(Path(out) / f"{one}.png", folder / f"{one}.png", 850)


if __name__ == "__main__":
    wanted = sys.argv[1:]
    if not wanted or "cloud" in wanted:
        save(cloud(), HERE / "cloud.png", 110)
    for name in DEMOS:
        if not wanted or name in wanted:
            demo(name)
    for name in PAPERS:
        if not wanted or name in wanted:
            paper(name)
    for name, cls in methods().items():
        if not wanted or name in wanted:
            save(picture(name, cls), HERE / "methods" / f"{name}.png")
