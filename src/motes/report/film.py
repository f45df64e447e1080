"""Clouds as pages show them: moments of a run in whole numbers of 16 bits, and what is told of each in rows."""

import bisect
from typing import Any, NamedTuple

import numpy as np

from motes.report.parts import rounded
from motes.report.scene import Scene

LARGEST = 65535
"""Of the whole numbers between the lowest and the highest particle."""
HEAVIEST = 255
MOST_POINTS, KEPT_POINTS = 20_000, 2_000
"""Particles of a moment that are drawn, and that are kept of one that is past."""
LEADING = ("step", "time", "seconds", "ess", "log_evidence", "alarm", "error")
"""Columns of a row before the coordinates."""
SPREAD = 200
"""Points that stand for a law without particles."""


class Seen(NamedTuple):
    """What a law is seen by.

    Attributes:
        mean: of the states, `(x,)`.
        cov: `(x, x)`.
        points: `(x, m)`, or None of a law without particles.
        log_weights: of the points, `(m,)`, or None.
        moving: places that the law knows, `(l, 2)`, or None.
    """

    mean: np.ndarray
    cov: np.ndarray
    points: np.ndarray | None = None
    log_weights: np.ndarray | None = None
    moving: np.ndarray | None = None


class Frame(NamedTuple):
    """One moment.

    Attributes:
        number: moments are numbered in the order in which they came.
        step: of the run.
        time: seconds, NaN where steps are only numbered.
        points: coordinates `(k, m)`, uint16 between `low` and `high`.
        weights: 255 times the square root of each weight over the largest, uint8 `(m,)`.
        low: `(k,)`.
        high: `(k,)`.
        mean: of the coordinates, `(k,)`.
        cov: `(k, k)`.
        truth: `(k,)`, NaN where it is not known.
        picture: JPEG of what stands behind it at this moment alone, or empty.
        moving: places that the law knows, `(l, 2)`.
        drawn: whether its points were drawn from mean and covariance, since the law has none or none was kept.
    """

    number: int
    step: int
    time: float
    points: np.ndarray
    weights: np.ndarray
    low: np.ndarray
    high: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    truth: np.ndarray
    picture: bytes = b""
    moving: np.ndarray | None = None
    drawn: bool = False

    @property
    def size(self) -> int:
        """Bytes that it takes."""
        return self.points.nbytes + self.weights.nbytes + self.cov.nbytes + len(self.picture) + 500

    def thinned(self, most: int) -> "Frame":
        """Return the same with so many particles at most."""
        every = -(-self.points.shape[1] // most)
        if every <= 1:
            return self
        # a slice would hold the whole array
        return self._replace(points=self.points[:, ::every].copy(), weights=self.weights[::every].copy())

    def along(self, axes: tuple[int, int]) -> tuple[dict[str, Any], bytes]:
        """Return what a page needs to draw it along two coordinates: numbers for JSON, and x, y (uint16), weights (uint8).

        A coordinate of -1 is the time.
        """
        now = self.step if np.isnan(self.time) else self.time
        header: dict[str, Any] = {"number": self.number, "step": self.step, "time": rounded(self.time), "count": self.points.shape[1],
                                  "axes": list(axes), "drawn": self.drawn, "moving": self._moved(),
                                  "low": [], "high": [], "mean": [], "truth": []}  # fmt: skip
        parts = []
        for axis in axes:
            across = (now, now, now, now) if axis < 0 else (self.low[axis], self.high[axis], self.mean[axis], self.truth[axis])
            for name, value in zip(("low", "high", "mean", "truth"), across, strict=True):
                header[name].append(rounded(value))
            parts.append(np.zeros(self.points.shape[1], np.uint16) if axis < 0 else self.points[axis])
        i, j = axes
        cov = [0.0 if min(pair) < 0 else self.cov[pair] for pair in ((i, i), (i, j), (j, j))]
        header["cov"] = [rounded(value) for value in cov]
        return header, b"".join([*(part.astype("<u2").tobytes() for part in parts), self.weights.tobytes()])

    def _moved(self) -> list[list[float | None]]:
        places = np.zeros((0, 2)) if self.moving is None else self.moving[np.isfinite(self.moving).all(axis=1)]
        return [[rounded(value, 6) for value in place] for place in places]


def frame(which: tuple[int, int, float], seen: Seen, scene: Scene, u: Any = None, picture: bytes = b"") -> Frame:
    """Return one moment in the coordinates of a scene; the covariance goes through them by secants over a standard deviation.

    Args:
        which: number, step and time of the moment.
        seen: what the law is seen by.
        scene: where it is drawn.
        u: inputs of the step.
        picture: JPEG behind it, or empty.
    """
    step = which[1]
    mean, cov = np.asarray(seen.mean, np.float64), np.asarray(seen.cov, np.float64)
    deviations = np.sqrt(np.maximum(np.nan_to_num(np.diagonal(cov)), 0))
    points, weights = _points_of(mean, cov, seen)
    if scene.place is not None:
        steps = np.where(deviations > 0, deviations, 1.0)
        around = np.concatenate([mean[:, None], mean[:, None] + np.diag(steps)], axis=1)
        placed = np.asarray(scene.place(around, u, step), np.float64)
        slopes = (placed[:, 1:] - placed[:, :1]) / steps
        points, mean, cov = np.asarray(scene.place(points, u, step), np.float64), placed[:, 0], slopes @ cov @ slopes.T
    known = np.isfinite(points).all(axis=0)
    points, weights = points[:, known], weights[known]
    low, high = (points.min(axis=1), points.max(axis=1)) if points.shape[1] else (mean, mean)
    reach = np.where(high > low, high - low, 1.0)
    whole = np.round((points - low[:, None]) / reach[:, None] * LARGEST).astype(np.uint16)
    there = scene.truth is not None and step < len(scene.truth)
    truth = np.asarray(scene.truth[step], np.float64) if there else np.full(len(scene.names), np.nan)  # type: ignore[index]
    return Frame(which[0], step, which[2], whole, weights, low, high, mean, cov, truth, picture, seen.moving, seen.points is None)


def _points_of(mean: np.ndarray, cov: np.ndarray, seen: Seen) -> tuple[np.ndarray, np.ndarray]:
    """Return points and their weights as they are drawn."""
    if seen.points is None or seen.log_weights is None:
        # the same draws at each moment, so that they move as the law does
        normal = np.random.default_rng(0).standard_normal((mean.size, SPREAD))
        variances, directions = np.linalg.eigh(np.nan_to_num(cov))
        points = mean[:, None] + directions @ (np.sqrt(np.maximum(variances, 0))[:, None] * normal)
        return points, np.full(SPREAD, HEAVIEST, np.uint8)
    log_weights = np.asarray(seen.log_weights, np.float64)
    some = np.flatnonzero(np.isfinite(log_weights))
    some = some[:: max(1, -(-some.size // MOST_POINTS))]
    log_weights = log_weights[some]
    shares = np.exp(0.5 * (log_weights - np.max(log_weights, initial=-np.inf)))
    return np.asarray(seen.points)[:, some].astype(np.float64), np.round(HEAVIEST * shares).astype(np.uint8)


def error_of(one: Frame, scene: Scene) -> float:
    """Return the distance of the mean from the truth in the coordinates that are judged; NaN where it is not known."""
    judged = list(scene.judged)
    if not judged:
        return float("nan")
    off = one.mean[judged] - one.truth[judged]
    turned = [place for place, axis in enumerate(judged) if axis in scene.angles]
    if turned:
        off[turned] = np.angle(np.exp(1j * off[turned]))
    return float(np.sqrt(np.sum(off**2)))


def row(one: Frame, scene: Scene, numbers: tuple[float, float, float, bool]) -> np.ndarray:
    """Return what is told of a moment: `LEADING`, then means, standard deviations and truth of the coordinates.

    Args:
        one: the moment.
        scene: where it is drawn.
        numbers: seconds of the step, effective size, log evidence, whether there was an alarm.
    """
    deviations = np.sqrt(np.maximum(np.diagonal(one.cov), 0))
    return np.concatenate([[one.step, one.time, *numbers, error_of(one, scene)], one.mean, deviations, one.truth])


class Reel:
    """The moments of the last minutes: where they take too much memory, every second of the older half goes."""

    def __init__(self, most: int, seconds: float = np.inf):
        """Hold so many bytes at most, and nothing older than so many seconds."""
        self.most, self.seconds = most, seconds
        self._frames: list[Frame] = []
        self._came: list[float] = []
        self._bytes = 0

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._frames)

    def add(self, one: Frame, now: float) -> None:
        """Keep one more moment.

        Args:
            one: the moment.
            now: when it came, seconds on any clock that never goes back.
        """
        self._frames.append(one)
        self._came.append(now)
        self._bytes += one.size
        old = bisect.bisect_left(self._came, now - self.seconds)
        if old:
            self._bytes -= sum(gone.size for gone in self._frames[:old])
            del self._frames[:old], self._came[:old]
        while self._bytes > self.most and len(self._frames) > 2:
            half = slice(1, max(2, len(self._frames) // 2), 2)
            self._bytes -= sum(gone.size for gone in self._frames[half])
            del self._frames[half], self._came[half]

    def near(self, wanted: int, by: int = 0) -> Frame | None:
        """Return the moment of a number, or the last one before it; or so many places after or before that. None where there is none."""
        if not self._frames:
            return None
        place = bisect.bisect_right(self._frames, wanted, key=lambda one: one.number) - 1
        return self._frames[min(max(place + by, 0), len(self._frames) - 1)]

    @property
    def reach(self) -> tuple[int, int, int]:
        """Numbers of the first and the last moment, and how many there are."""
        return (self._frames[0].number, self._frames[-1].number, len(self._frames)) if self._frames else (0, 0, 0)

    def chosen(self, count: int) -> list[Frame]:
        """Return so many moments at most, evenly spread, the first and the last among them."""
        places = np.unique(np.linspace(0, len(self._frames) - 1, count).round().astype(int)) if self._frames else ()
        return [self._frames[place] for place in places]
