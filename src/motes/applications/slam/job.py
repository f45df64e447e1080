"""The robot without a map as an application: `motes demo slam`, and `motes run`, `motes plan` and `motes study` of its settings."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.applications.interface import Job, Score
from motes.applications.robot.bag import read_recording
from motes.applications.robot.world import simulated
from motes.applications.slam import recording as recorded
from motes.applications.slam.model import ranging, seeing
from motes.applications.slam.settings import Settings
from motes.applications.slam.world import made_up
from motes.core import checks
from motes.filters import keep
from motes.filters.history import History
from motes.filters.landmark import LandmarkFilter
from motes.io.bags import is_bag
from motes.io.recordings import write_plaza
from motes.laws.cloud import Cloud
from motes.report.scene import Moving, Scene
from motes.smoothers.genealogy import GenealogySmoother
from motes.smoothers.smooth import smooth

TENTH = 10
"""Part of the way that odometry alone tells well enough to lay the true one on."""
RANGES, GRAPH = "recording.mat", "recording.txt"


def load(settings: Settings, seed: int) -> "SlamJob":
    """Read the recording that the settings name, or make one up.

    Args:
        settings: of the application.
        seed: of a recording that is made up.

    Raises:
        FileError: the file cannot be used.
        MotesError: a setting cannot be used.
    """
    checks.positive_integer("gaussians", settings.gaussians)
    checks.above_zero("scale", settings.scale)
    by_ranges = settings.data.lower().endswith(".mat") or is_bag(settings.data) if settings.data else settings.sights == "ranges"
    if by_ranges:
        recording = read_recording(settings.data, settings.topics, settings.units) if settings.data else simulated(seed, settings.seconds)
        start = recording.start
        way, write = recorded.by_ranges(recording), (lambda folder: write_plaza(folder / RANGES, recording))
        model = ranging(way.landmarks, settings.gaussians, settings.scale)
    else:
        if settings.units:
            checks.refuse("units", "none of a recording of landmarks seen", ", ".join(settings.units)[:80])
        start, world = 0.0, None if settings.data else made_up(seed, settings.seconds)
        graph = recorded.read_graph(settings.data) if world is None else world.graph
        way = recorded.by_places(graph) if world is None else recorded.by_places(*world)
        write, model = (lambda folder: recorded.write_graph(folder / GRAPH, graph)), seeing(way.landmarks)
    return SlamJob(
        model=model, ys=way.ys, inputs=jax.tree.map(lambda leaf: jnp.asarray(leaf, float), way.inputs), times=way.times, way=way,
        write=write, file=RANGES if by_ranges else GRAPH, keep=with_map, counted=("px", "py"), start=start,
        filters={"landmarks": LandmarkFilter(n=100, on_collapse="predict")},
    )  # fmt: skip


def with_map(law: Any) -> dict[str, Any]:
    """Keep mean and covariance, particles with their ancestors, and the landmarks of the best particle: places `(L, J, 2)` and weights."""
    best = jnp.argmax(law.log_weights)
    shares = jnp.where(law.map.seen[:, None, best], jnp.exp(law.map.log_shares[..., best]), 0)
    return {**keep.paths(law), "places": law.map.centers[:, :, :2, best], "shares": shares}


@dataclass(frozen=True, eq=False, kw_only=True)
class SlamJob(Job):
    """A robot's way and its map; both are laid on the truth by a turn and a shift, since a robot without a map has no north.

    Attributes:
        way: what the filter gets, and the truth.
        write: writes the recording to a folder.
        file: name that it has there.
    """

    way: recorded.Way
    write: Callable[[Path], None]
    file: str

    def about(self) -> str:
        """Tell of landmarks and sightings."""
        count = int((np.asarray(self.ys.value["landmark"]) >= 0).sum())
        return f"{self.way.landmarks} landmarks at unknown places, {count} sightings in {len(self.way.alone)} steps."

    def title(self, steps: int) -> str:
        """Return the number of steps, and how good the odometry is alone."""
        if self.way.truth is None:
            return f"{steps} steps"
        alone = rms(self.way.truth, self.way.alone)
        return f"{steps} steps; errors after the path is laid on the true one (by odometry alone {alone:.2f} m)"

    def scores(self, history: History) -> tuple[Score, ...]:
        """Judge a run by the true way: the path that the last particles have come, and the landmarks."""
        if self.way.truth is None:
            return ()
        path, truth = self.path(history), self.way.truth
        found = {"path rms": rms(truth, path), "on-line rms": rms(truth, _filtered(history))}
        if self.way.places is not None:
            apart = np.hypot(*(laid_on(truth, path)(self.landmarks(history)) - self.way.places).T)
            found |= {"landmarks rms": float(np.sqrt(np.nanmean(apart**2))), "worst landmark": float(np.nanmax(apart))}
        return tuple(Score(name, value, "m", 2) for name, value in found.items())

    def path(self, history: History) -> np.ndarray:
        """Places `(t, 2)` on the way that the last particles have come; the filter's own where their ancestors were not kept."""
        if not isinstance(history.kept.get("law"), Cloud):
            return _filtered(history)
        found = smooth(0, GenealogySmoother(), self.model, history, self.ys, self.inputs)
        return np.asarray(found.mean, np.float64)[:, :2]

    def landmarks(self, history: History) -> np.ndarray:
        """Mean places of the landmarks at the end, `(L, 2)`; NaN of those that were not seen."""
        return np.asarray(history.state.landmarks().mean, np.float64)[:, :2]

    def verdict(self, history: History) -> str:
        """Say how many landmarks were found, and how surely."""
        found = history.state.landmarks()
        spread = np.sqrt(np.asarray(found.cov)[:, :2, :2].trace(axis1=1, axis2=2))
        seen = np.asarray(found.seen) > 0
        return (f"{seen.sum()} of {len(seen)} landmarks are on the map; standard deviation of their places {np.median(spread[seen]):.2f} m "
                f"(median), {spread[seen].max():.2f} m (worst). {history}")  # fmt: skip

    def scene(self) -> Scene:
        """Return the plane from where the robot began, with its landmarks; the true way is laid on the first part of that by odometry."""
        names, truth = tuple(self.model.names), None
        if self.way.truth is not None:
            truth = np.full((len(self.way.truth), len(names)), np.nan)
            known = np.flatnonzero(~np.isnan(self.way.truth).any(axis=1))
            begin = known[: max(3, len(known) // TENTH)]
            truth[:, :2] = laid_on(self.way.alone[begin], self.way.truth[begin])(self.way.truth)
        return Scene(names=names, units=("m", "m", "rad"), truth=truth, judged=(), title="Robot without a map",
                     moving=Moving("landmark", _mapped), angles=tuple(self.model.circular))  # fmt: skip

    def pictures(self, histories: Mapping[str, History]) -> dict[str, Any]:
        """Draw the map with the ways, and how it came to be."""
        from motes.applications.slam.pictures import map_animation, map_figure

        history = next(iter(histories.values()))
        return {"map.png": map_figure(history, self), "map.gif": map_animation(history, self)}

    def written(self, folder: Path, settings: Settings) -> Settings:
        """Write a recording that was made up, in the form of the real ones."""
        if settings.data:
            return settings
        self.write(folder)
        return replace(settings, data=str(folder / self.file))


def _mapped(law: Any) -> Any:
    found = law.landmarks()
    return jnp.where(found.seen[:, None] > 0, found.mean[:, :2], jnp.nan)


def _filtered(history: History) -> np.ndarray:
    return np.asarray(history.mean, np.float64)[:, :2]


def rms(truth: np.ndarray, path: np.ndarray) -> float:
    """Root mean square distance of a path from the true one, once laid on it."""
    apart = laid_on(truth, path)(path) - truth
    return float(np.sqrt(np.nanmean((apart**2).sum(axis=1))))


def laid_on(truth: np.ndarray, path: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Return the turn and shift that lay a path `(t, 2)` on the true one in the sense of least squares (Horn 1987); NaN are left out."""
    known = ~np.isnan(truth).any(axis=1)
    to, of = truth[known] @ [1, 1j], path[known] @ [1, 1j]
    turn = np.exp(1j * np.angle(np.sum(np.conj(of - of.mean()) * (to - to.mean()))))

    def laid(points: np.ndarray) -> np.ndarray:
        moved = (points @ [1, 1j] - of.mean()) * turn + to.mean()
        return np.stack([np.real(moved), np.imag(moved)], axis=-1)

    return laid
