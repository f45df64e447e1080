"""Targets whose number is not known: what is told of their tracks, by target where the truth is known."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from motes.applications.interface import Moment, Score
from motes.applications.target_tracking.model import Tracker
from motes.applications.target_tracking.shared import LOST, RadarJob
from motes.applications.target_tracking.tracks import follow
from motes.core import checks
from motes.core.findings import Diagnosis, Finding
from motes.core.record import replace
from motes.diagnostics.sets import changes, followers, gospa
from motes.filters import notices
from motes.filters.history import History
from motes.filters.interface import Filter
from motes.filters.keep import Keep
from motes.io.result_table import Table

TRACK = ("time", "track", "east", "north", "v_east", "v_north", "exists")
TARGET = ("target", "from, s", "to, s", "confirmed after, s", "tracked, %", "rms, m", "swaps")


class Judged(NamedTuple):
    """Tracks held against the truth.

    Attributes:
        there: whether a target is there, `(t, n)`.
        followers: confirmed track that follows each target, `(t, n)`, -1 for none.
        off: its distance, `(t, n)`, NaN for none, m.
    """

    there: np.ndarray
    followers: np.ndarray
    off: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class SeveralJob(RadarJob):
    """Targets that come and go.

    Attributes:
        tracker: makes the model of each track.
        targets: their names; `truth` is `(t, n, 4)`, NaN where one is not there. Both are empty where nothing is known.
    """

    goes_on = False
    tracker: Tracker
    targets: tuple[str, ...]

    def pieces(
        self, seed: int, filter: Filter, ys: Any, inputs: Any, keep: Keep, chunk: int, after: History | None = None
    ) -> Iterator[History]:
        """Follow all targets, each track by the filter; one piece, since tracks are numbered at the end."""
        if keep is not self.keep:
            checks.refuse("smoother", "none where several targets are followed", "one")
        # a track that explains no scan ends by its existence
        yield follow(seed, replace(filter, on_collapse="predict"), self.tracker, self.times, ys, self.radar)

    def moments(self) -> Iterator[Moment]:
        """Refuse: tracks begin and end by themselves, and there is no one law to look at."""
        checks.refuse("watch", "one target (targets = 1)", f"{len(self.targets) or 'an unknown number of'} targets")

    def title(self, steps: int) -> str:
        """Return how many scans and targets there were."""
        return f"{steps} scans" if self.truth is None else f"{steps} scans, {len(self.targets)} targets; means over scans and targets"

    def places(self, history: History) -> np.ndarray:
        """East and north `(t, m, 2)` of tracks since they were confirmed, NaN elsewhere."""
        return np.where(history.kept["confirmed"][..., None], history.kept["states"][..., :2], np.nan)

    def judged(self, history: History) -> Judged:
        """Hold the confirmed tracks against the truth."""
        places, truth = self.places(history), np.asarray(self.truth)[..., :2]
        found = followers(places, truth, LOST)
        own = np.take_along_axis(places, np.maximum(found, 0)[..., None], axis=1) if places.shape[1] else np.full(truth.shape, np.nan)
        off = np.where(found >= 0, np.hypot(*np.moveaxis(own - truth, -1, 0)), np.nan)
        return Judged(np.asarray(~np.isnan(truth).any(axis=-1)), found, off)

    def scores(self, history: History) -> tuple[Score, ...]:
        """Judge the tracks by the truth."""
        count = history.kept["confirmed"].shape[1]
        tracks = Score("tracks", count, digits=0)
        if self.truth is None:
            return (tracks,)
        judged, truth = self.judged(history), np.asarray(self.truth)[..., :2]
        apart = [gospa(own[~np.isnan(own).any(axis=1)], true[there], LOST).distance
                 for own, true, there in zip(self.places(history), truth, judged.there, strict=True)]  # fmt: skip
        false = count - len(set(judged.followers.ravel().tolist()) - {-1})
        return (Score("GOSPA", float(np.mean(apart)), "m", 0), Score("position", _rms(judged.off), "m", 0),
                Score("tracked", _percent(judged.followers >= 0, judged.there), "%", 0), tracks, Score("false tracks", false, digits=0),
                Score("swaps", int(changes(judged.followers).sum()), digits=0))  # fmt: skip

    def by_target(self, history: History) -> Table:
        """Return a row for each target: from when to when it is there, and how its tracks were."""
        judged = self.judged(history)
        rows = []
        for name, there, tracks, off, swaps in zip(self.targets, judged.there.T, judged.followers.T, judged.off.T,
                                                   changes(judged.followers), strict=True):  # fmt: skip
            seconds, followed = self.times[there], self.times[tracks >= 0]
            wait = float(followed[0] - seconds[0]) if followed.size else None
            rows.append((name, float(seconds[0]), float(seconds[-1]), wait, _percent(tracks >= 0, there), _rms(off), int(swaps)))
        return Table(TARGET, tuple(rows))

    def verdict(self, history: History) -> str:
        """Tell of each target."""
        return "" if self.truth is None or not self.targets else str(self.by_target(history))

    def track(self, history: History) -> None:
        """Return nothing: the table of tracks has all of them."""
        return

    def diagnosed(self, history: History) -> Diagnosis:
        """Judge by what a run says unasked, and by whether something was followed."""
        found = notices.notices(history)
        if not np.asarray(history.kept["confirmed"]).any():
            found.append(Finding("no track", "no track was confirmed.", "Look at units, at the radar's numbers, and at the period.", True))
        return Diagnosis.of(found)

    def tables(self, history: History) -> dict[str, Table]:
        """Return all tracks, scan by scan since they were confirmed, at the times of the file; and what is told of each target."""
        steps, tracks = np.nonzero(history.kept["confirmed"])
        rows = zip(self.clock.written(self.start + self.times[steps]), (tracks + 1).tolist(),
                   history.kept["states"][steps, tracks].tolist(),
                   history.kept["exists"][steps, tracks].tolist(), strict=True)  # fmt: skip
        found = {"tracks": Table(TRACK, tuple((time, track, *states, exists) for time, track, states, exists in rows))}
        return found if self.truth is None else found | {"targets": self.by_target(history)}

    def pictures(self, histories: Mapping[str, History]) -> dict[str, Any]:
        """Draw all tracks over plots and truth, and when each was there."""
        from motes.applications.target_tracking.pictures import tracks_figure

        return {"tracks.png": tracks_figure(next(iter(histories.values())), self)}


def _rms(off: np.ndarray) -> float | None:
    return None if np.isnan(off).all() else float(np.sqrt(np.nanmean(off**2)))


def _percent(part: np.ndarray, whole: np.ndarray) -> float | None:
    return 100 * float(part.sum() / whole.sum()) if whole.any() else None
