"""Draws the cost of the bootstrap filters against the number of particles."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from report import measured, typical

COLORS = {"motes (JAX)": "#1f6fb2", "motes (native)": "#0b3d66", "C++ yardstick": "#999999"}
PANELS = {"line": "1-D linear Gaussian", "radar": "radar, six states"}


def draw(results: dict, path: Path) -> None:
    """Draw ns per particle and step by engine and number of particles, and write the picture."""
    figure, panels = plt.subplots(1, len(PANELS), figsize=(10, 4), sharey=True, layout="constrained")
    for panel, (model, title) in zip(panels, PANELS.items(), strict=True):
        points: dict[str, dict[int, float]] = {}
        for record in measured(results["records"]):
            if record["case"] == "bootstrap" and record["model"] == model and "covariance" not in record["engine"]:
                points.setdefault(record["engine"], {})[record["n"]] = typical(record)
        for name, costs in points.items():
            style = {"color": COLORS.get(name), "linewidth": 2.2 if name in COLORS else 1.1, "marker": "o", "markersize": 4}
            panel.loglog(list(costs), list(costs.values()), linestyle="--" if "yardstick" in name else "-", **style)
            panel.annotate(name, (max(costs), costs[max(costs)]), xytext=(6, 0), textcoords="offset points", fontsize=8, va="center")
        panel.set(title=title, xlabel="particles")
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(axis="y", color="#eeeeee")
        panel.margins(x=0.3)
    panels[0].set_ylabel("ns per particle and step")
    figure.savefig(path, dpi=150)
    plt.close(figure)
