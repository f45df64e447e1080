"""Where a flight leaves its map, or comes near what the map does not know."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from motes.applications.terrain.model import Track, altimeter, unaided
from motes.applications.terrain.recording import A_DEGREE
from motes.core import checks
from motes.core.record import replace
from motes.models.state_space import StateSpaceModel
from motes.models.terrain import TerrainMap

REACH = 5.0
"""Standard deviations of the inertial position within which voids of the map count."""
SEGMENTS = 50


def check_covered(
    terrain: TerrainMap, north: np.ndarray, east: np.ndarray, what: str, misreadings: Sequence[tuple[str, np.ndarray, np.ndarray]] = ()
) -> None:
    """Refuse a map that a track leaves; one beyond which lies a void, only where the whole track is off it.

    Args:
        terrain: the map.
        north: of the track, `(t,)`, m.
        east: likewise.
        what: the track, in words.
        misreadings: what may have been meant: advice, north and east of each; given where most of that track lies on the map.

    Raises:
        MotesError: naming the extents of both, and the first row outside.
    """
    on = _inside(terrain, north, east)
    if on.all() or (terrain.beyond == "void" and on.any()):
        return
    height, width = terrain.size
    unit = "meters" if max(terrain.scale) < A_DEGREE else "degrees"
    meant = (advice for advice, *other in misreadings if _inside(terrain, *other).mean() > max(0.5, on.mean()))
    checks.refuse(
        "map",
        f"one that covers {what} (north {north.min():.0f} to {north.max():.0f} m, east {east.min():.0f} to {east.max():.0f} m "
        "of the map's south-west post)",
        f"north 0 to {height:.0f} m, east 0 to {width:.0f} m; row {int(np.argmin(on)) + 1} lies outside",
        next(meant, f"Check order and unit of the columns (the map's own coordinates are {unit}), or join more map files."),
    )


def _inside(terrain: TerrainMap, north: np.ndarray, east: np.ndarray) -> np.ndarray:
    height, width = terrain.size
    return (north >= 0) & (north <= height) & (east >= 0) & (east <= width)


def over_map(terrain: TerrainMap, inertial: Track, ys: jax.Array) -> jax.Array:
    """Return fixes `(t, 1)` with NaN for those whose inertial position lies in the void beyond the map."""
    if terrain.beyond == "edge":
        return ys
    return jnp.where(terrain.inside(inertial.north, inertial.east)[:, None], ys, jnp.nan)


def without_far_voids(model: StateSpaceModel, inertial: Track, deviation: float) -> StateSpaceModel:
    """Return the model with the mean height in voids that no particle comes near, and without a void beyond edges far away.

    Voids within reach make the altimeter's variance differ between particles, so that each needs its own covariance, which takes many
    times as long; a void at the other end of the map should not cost that.

    Args:
        model: of the errors, with an altimeter over the whole map.
        inertial: the inertial track, `(t,)`.
        deviation: of the altimeter, m.
    """
    terrain: TerrainMap = model.sensor.f.terrain  # type: ignore[attr-defined]
    heights = np.asarray(terrain.heights)
    if not np.isnan(heights).any() and terrain.beyond == "edge":
        return model
    reach = REACH * unaided(model, inertial)
    near, leaves = np.zeros(heights.shape, bool), False
    for part in np.array_split(np.arange(len(reach)), min(SEGMENTS, len(reach))):
        sides = []
        for axis, (along, spacing) in enumerate(((inertial.north, terrain.dn), (inertial.east, terrain.de))):
            cells = np.asarray(along)[part] / spacing
            around = reach[part, axis].max() / spacing
            low, high = cells.min() - around, cells.max() + around
            leaves = leaves or low < 0 or high > heights.shape[axis] - 1
            sides.append(slice(max(int(low), 0), max(int(high) + 2, 0)))
        near[tuple(sides)] = True
    filled = jnp.where(near, terrain.heights, jnp.nan_to_num(terrain.heights, nan=np.nanmean(heights)))
    reduced = replace(terrain, heights=filled, beyond=terrain.beyond if leaves else "edge")
    return replace(model, sensor=altimeter(reduced, deviation, model.names))
