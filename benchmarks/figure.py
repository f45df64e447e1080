"""Draws the cost of the bootstrap filters: against the number of particles, and as bars for one."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from report import measured, typical

COLORS = {
    "motes": "#0b3d66",
    "motes (JAX)": "#2f86cf",
    "C++ yardstick": "#999999",
    "particles": "#c8553d",
    "smcx": "#e09f3e",
    "cuthbert": "#7a9e4f",
    "stonesoup": "#8d6a9f",
}
OWN = ("motes", "motes (JAX)")
PANELS = {"line": "1-D linear Gaussian", "radar": "radar, six states"}


def draw(results: dict, path: Path) -> None:
    """Draw ns per particle and step by engine and number of particles, and write the picture."""
    figure, panels = plt.subplots(1, len(PANELS), figsize=(10, 4), sharey=True, layout="constrained")
    for panel, (model, title) in zip(panels, PANELS.items(), strict=True):
        points: dict[str, dict[int, float]] = {}
        for record in measured(results["records"]):
            if record["case"] == "bootstrap" and record["model"] == model and record["engine"] in COLORS:
                points.setdefault(record["engine"], {})[record["n"]] = typical(record)
        height = 0.0
        for name, costs in sorted(points.items(), key=lambda item: list(item[1].values())[-1]):
            color, last = COLORS[name], costs[max(costs)]
            width, dashes = 2.2 if name in OWN else 1.1, "--" if "yardstick" in name else "-"
            panel.loglog(list(costs), list(costs.values()), color=color, linewidth=width, linestyle=dashes, marker="o", markersize=3.5)
            # names that would lie on each other are moved apart
            height = max(last, height * 1.3)
            panel.text(max(costs) * 1.25, height, name, fontsize=8, va="center", color=color)
        panel.set(title=title, xlabel="particles")
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(axis="y", color="#eeeeee")
        panel.set_xlim(right=panel.get_xlim()[1] * 8)
    panels[0].set_ylabel("ns per particle and step")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def bars(results: dict, path: Path, n: int = 200_000) -> None:
    """Draw the cost of the radar filter with n particles as bars, and write the picture."""
    costs = {
        record["engine"]: typical(record)
        for record in measured(results["records"])
        if (record["case"], record["model"], record["n"]) == ("bootstrap", "radar", n) and record["engine"] in COLORS
    }
    names = sorted(costs, key=costs.get)
    figure, panel = plt.subplots(figsize=(7, 0.5 + 0.36 * len(names)), layout="constrained")
    drawn = panel.barh(names, [costs[name] for name in names], color=[COLORS[name] for name in names], height=0.7)
    panel.bar_label(drawn, [f"{costs[name]:.3g}" for name in names], padding=4, fontsize=9)
    panel.invert_yaxis()
    panel.set(xlabel=f"ns per particle and step: radar, six states, {n:,} particles")
    panel.spines[["top", "right"]].set_visible(False)
    panel.tick_params(left=False)
    figure.savefig(path, dpi=150)
    plt.close(figure)
