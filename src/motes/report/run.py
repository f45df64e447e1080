"""A run as one web page: facts, what is wrong in words, pictures of the law, and numbers over time; it asks no network for anything."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from motes.core import checks
from motes.core.findings import Finding
from motes.diagnostics.diagnose import diagnose
from motes.filters.history import History
from motes.io.archive import provenance
from motes.models.state_space import at_step
from motes.report.film import LEADING, Frame, Seen, frame, row
from motes.report.parts import filled, html_table, origin_table, rounded
from motes.report.scene import Scene, encoded, scene_of

MOMENTS, POINTS = 12, 1_000
"""Moments that are shown, and particles of each."""
ROWS = 2_000


@dataclass(frozen=True, eq=False, kw_only=True)
class Film:
    """What is shown of a run.

    Attributes:
        title: heading.
        facts: name and text of each.
        scene: where the law is drawn.
        frames: moments that are drawn.
        rows: numbers of the steps, `(t, c)`, in the order of `columns_of(scene)`.
        findings: what is wrong.
    """

    title: str
    facts: Sequence[tuple[str, str]]
    scene: Scene
    frames: Sequence[Frame]
    rows: np.ndarray
    findings: Sequence[Finding]


def columns_of(scene: Scene) -> tuple[str, ...]:
    """Return what the columns of a row are: `LEADING`, and of each coordinate mean, standard deviation and truth."""
    return (*LEADING, *(f"{name} {what}" for what in ("mean", "sd", "truth") for name in scene.names))


def run_page(film: Film) -> str:
    """Return the web page of a run."""
    scene = film.scene
    axes = (0, 1) if len(scene.names) > 1 else (-1, 0)
    frames = []
    for one in film.frames:
        header, body = one.thinned(POINTS).along(axes)
        picture = f"data:image/jpeg;base64,{_base64(one.picture)}" if one.picture else ""
        frames.append({"header": header, "body": _base64(body), "picture": picture})
    ground = "" if scene.picture is None else f"data:image/png;base64,{_base64(encoded(scene.picture, 'PNG'))}"
    rows = film.rows[:: max(1, -(-len(film.rows) // ROWS))]
    columns = columns_of(scene)
    data = {"scene": scene.described(), "columns": columns, "frames": frames, "picture": ground,
            "rows": [[rounded(value, 7) for value in each] for each in rows]}  # fmt: skip
    said = "".join(f"<li>{escape(str(one))}</li>" for one in film.findings)
    return filled(
        "run", ("uplot/uPlot.iife.min.js", "cloud.js", "run.js"), ("uplot/uPlot.min.css", "colors.css"),
        title=film.title, data=data, images=True, facts=html_table(("", ""), film.facts, 2),
        findings=f"<ul>{said}</ul>" if said else "<p>Nothing wrong was found.</p>",
        provenance=origin_table(provenance()),
    )  # fmt: skip


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode()


def film_of(history: History, scene: Scene | None, truth: Any, title: str) -> Film:
    """Return what is shown of a history.

    Args:
        history: with moments; particles are drawn where the run kept some (`keep=mo.keep.laws`).
        scene: where the law is drawn; its first two states if None.
        truth: true states `(t, x)`, where no scene is given; or None.
        title: heading.

    Raises:
        MotesError: the history kept no moments, or truth has another shape.
    """
    mean, cov = np.asarray(history.mean, np.float64), np.asarray(history.cov, np.float64)
    if truth is not None:
        checks.shape("report truth", truth, mean.shape, "(steps, states)")
    scene = scene_of(history.names, truth, history.circular) if scene is None else scene
    steps, info, first = len(mean), history.info, int(history.start)
    times = np.full(steps, np.nan) if history.times is None else np.asarray(history.times, np.float64)
    shown = set(np.unique(np.linspace(0, steps - 1, MOMENTS).round().astype(int)).tolist())
    wanted = sorted(shown | set(range(0, steps, max(1, -(-steps // ROWS)))))
    frames, rows = [], []
    for step in wanted:
        points = _points_kept(history, step) if step in shown else None
        one = frame((step, first + step, float(times[step])), Seen(mean[step], cov[step], *(points or ())), scene)
        numbers = (np.nan, float(info.ess[step]), float(info.log_evidence[step]), bool(info.alarm[step]))
        rows.append(row(one, scene, numbers))
        if step in shown:
            frames.append(one)
    diagnosis = diagnose(history) if scene.place is not None or truth is None else diagnose(history, truth)
    facts = [("filter", history.label), ("steps", f"{first} to {first + steps - 1}")]
    if history.has_evidence:
        facts.append(("log likelihood", f"{float(history.log_likelihood):.6g}"))
    if history.particles:
        ess = np.asarray(history.ess)
        facts.append(("effective size", f"{np.median(ess):.4g} of {history.particles} (median), {ess.min():.3g} at the least"))
    return Film(title=title, facts=facts, scene=scene, frames=frames, rows=np.array(rows), findings=diagnosis.findings)


def _points_kept(history: History, step: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Return particles and log weights of a step, where they were kept."""
    if "cloud" in history.kept:
        cloud = np.asarray(history.kept["cloud"][step])
        return cloud, np.zeros(cloud.shape[1])
    if "law" not in history.kept:
        return None
    found = at_step(history.law, step).weighted_points()
    return None if found is None else (np.asarray(found[0]), np.asarray(found[1]))
