"""Whether terrain can support navigation, told before a flight: how much its heights vary, and the error that may be expected.

Two errors are worked out along the inertial track, both as covariances of a Kalman filter. The bound knows the slopes at the track: no
filter does better, but over nearly flat ground it takes the meter steps of the map for landmarks, which nobody lost by a kilometer could
tell apart. The expected error therefore looks at the map as widely as the position is uncertain at the time: slopes are those of the
regression of height on position over five points (the mean and, along each axis of a factor of the covariance, root three standard
deviations to both sides), and what the regression leaves unexplained counts as noise of the altimeter.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.applications.terrain.model import NoiseOverVoids, Track, places_of, unaided
from motes.bounds.at_truth import kalman_at_truth
from motes.core import linalg
from motes.core.loop import loop
from motes.core.record import replace
from motes.gaussian.sigma_points import regressed_on, unscaled
from motes.gaussian.taylor import Taylor
from motes.laws.gaussian import Gaussian
from motes.models.state_space import StateSpaceModel
from motes.models.terrain import TerrainMap
from motes.tracing.compiling import jitted

MOST = 400
"""Fixes whose surroundings are looked at."""
ROUGH, FLAT = 0.1, 0.5
"""Share of the unaided error that the altimeter leaves over rough and over flat terrain."""


class Roughness(NamedTuple):
    """What the terrain around a track tells.

    Attributes:
        window: half the side of the squares around fixes that were looked at, m: the prior's standard deviation.
        heights: standard deviation of the heights in such a square, median over the fixes, m.
        slopes: the same of the slopes, root mean square of those to the north and to the east.
        flat: share of fixes around which heights vary by less than the altimeter's noise, voids included.
        expected: horizontal error to be expected at each fix, `(t,)`, m.
        bound: the least that can be reached, once the position is nearly known.
        unaided: what there is without altimeter.
    """

    window: float
    heights: float
    slopes: float
    flat: float
    expected: np.ndarray
    bound: np.ndarray
    unaided: np.ndarray

    @property
    def verdict(self) -> str:
        """Return "rough enough", "poor" or "flat", by the share of the unaided error that the altimeter leaves after the flight.

        Where it leaves most of it although the ground is not flat (an even slope, or too short a flight), the word is "poor".
        """
        left = self.expected[-1] / self.unaided[-1]
        return "rough enough" if left < ROUGH else "flat" if left >= FLAT and self.flat >= 0.5 else "poor"

    def __str__(self) -> str:
        """Return the verdict and its reasons in one line."""
        ground = (f"heights vary by {self.heights:.0f} m and slopes by {self.slopes:.2f} within {self.window:.0f} m of the track, "
                  f"{100 * self.flat:.0f} % of the fixes lie over flat ground")
        error = (f"expected horizontal error after the flight about {self.expected[-1]:.0f} m (at best {self.bound[-1]:.0f} m, "
                 f"without altimeter {self.unaided[-1]:.0f} m)")
        reason = {
            "rough enough": "",
            "poor": "the altimeter helps little, or not in all directions; ",
            "flat": "the altimeter tells next to nothing about where the aircraft is; ",
        }[self.verdict]
        return f"Terrain: {self.verdict}: {ground}; {reason}{error}."


def roughness(model: StateSpaceModel, track: Track) -> Roughness:
    """Tell beforehand whether terrain can support navigation.

    Args:
        model: of the errors, by `error_model`; its altimeter holds the map.
        track: the inertial track, or one that is planned, `(t,)`.
    """
    altimeter: Any = model.sensor
    terrain: TerrainMap = altimeter.f.terrain
    noise = np.sqrt(altimeter.Q.variance if isinstance(altimeter.Q, NoiseOverVoids) else float(altimeter.Q[0, 0]))
    window = float(jnp.sqrt(model.initial.cov()[model.names.index("rN"), model.names.index("rN")]))
    looked_at = np.unique(np.linspace(0, track.north.shape[0] - 1, MOST).astype(int))
    around = np.array([_spreads(terrain, float(track.north[k]), float(track.east[k]), window) for k in looked_at])
    smooth = replace(altimeter.f, terrain=replace(terrain, interpolation="cubic"))
    known = jnp.zeros((track.north.shape[0], model.size), model.dtype)
    bound = kalman_at_truth(replace(model, sensor=replace(altimeter, f=smooth)), known, track)
    heights, slopes = np.median(around, axis=0)
    return Roughness(
        window, float(heights), float(slopes), flat=float(np.mean(around[:, 0] < noise)),
        expected=np.asarray(_expected(model, track), np.float64),
        bound=np.asarray(bound.rmse(("rN", "rE")), np.float64),
        unaided=np.linalg.norm(unaided(model, track), axis=1),
    )


@jitted
def _expected(model: Any, track: Track) -> jax.Array:
    """Return the expected horizontal error at each fix, `(t,)`, m."""
    *across, down = places_of(model.names)
    zero = jnp.zeros(model.size, model.dtype)

    def measured(cov: jax.Array, u: Track, t: Any) -> jax.Array:
        factor = linalg.cholesky(linalg.take(linalg.take(cov, across), across, axis=1))
        _, scaled_slope, unexplained = regressed_on(model.sensor, across, zero[:, None], factor, u, t)
        H = zero.at[np.array(across)].set(unscaled(scaled_slope[..., 0], factor)[0]).at[down].set(-1.0)
        R = model.sensor.cov(zero, u, t) + jnp.maximum(unexplained[..., 0], 0)
        return Gaussian(zero, cov).corrected(jnp.zeros(1, zero.dtype), H[None], R).law.covariance

    def advance(cov: jax.Array, now: tuple[Track, Any]) -> tuple[jax.Array, jax.Array]:
        cov = jnp.where(now[1] > 0, Taylor().through(model.dynamics, Gaussian(zero, cov), *now).covariance, cov)
        cov = measured(cov, *now)
        return cov, jnp.sqrt(jnp.sum(jnp.diagonal(cov)[np.array(across)]))

    return loop(advance, model.initial.cov(), (track, jnp.arange(track.north.shape[0], dtype=jnp.int32)))[1]


def _spreads(terrain: TerrainMap, north: float, east: float, window: float) -> tuple[float, float]:
    """Return standard deviations of heights (m) and slopes in the square around a place; zeros where there are none."""
    heights = np.asarray(terrain.heights)
    sides = [slice(max(int((at - window) / step), 0), max(int((at + window) / step) + 2, 0))
             for at, step in ((north, terrain.dn), (east, terrain.de))]
    square = heights[tuple(sides)].astype(np.float64)
    slopes = [np.diff(square, axis=axis) / step for axis, step in enumerate((terrain.dn, terrain.de))]
    return _variance(square) ** 0.5, (sum(map(_variance, slopes)) / 2) ** 0.5


def _variance(values: np.ndarray) -> float:
    known = values[~np.isnan(values)]
    return float(known.var()) if known.size else 0.0
