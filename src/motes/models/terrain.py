"""Terrain as a function of position: heights and slopes between the posts of a grid, ready for jit, vmap and differentiation."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core.checks import as_float, is_concrete, option, refuse
from motes.core.record import record, static
from motes.io.rasters import Raster


@record
class TerrainMap:
    """A grid of heights in a local metric frame whose origin is the south-west post.

    Positions are meters north and east of that post. Between posts heights are bilinear, from the four posts of the cell;
    slopes jump at the lines between cells, where those of the cell to the north and east count. Cubic heights (Catmull and Rom
    1974: splines through 16 posts, straight on beyond the outermost) have slopes that do not jump, for bounds, which
    differentiate the map; they take about three times as long. Look-ups beyond the edge take the height of the nearest edge and
    no slope across it, or are NaN where the world beyond is a void; `inside` tells. A look-up that needs a void is NaN.

    Attributes:
        heights: `(rows, columns)`, meters, NaN at voids; row 0 is the SOUTHERNMOST, column 0 the westernmost.
        dn: distance between rows, meters.
        de: distance between columns, meters.
        origin: latitude and longitude (degrees) or northing and easting (meters) of the south-west post.
        scale: meters per unit of those two coordinates.
        interpolation: "bilinear" or "cubic".
        beyond: what lies beyond the outermost posts, "edge" or "void".
        latitude: of the middle of the map, degrees; None where it is not known.
    """

    heights: jax.Array
    dn: float
    de: float
    origin: tuple[float, float] = static(default=(0.0, 0.0))
    scale: tuple[float, float] = static(default=(1.0, 1.0))
    interpolation: str = static(default="bilinear")
    beyond: str = static(default="edge")
    latitude: float | None = static(default=None)

    def __post_init__(self) -> None:
        """Check the grid, the spacing and the words."""
        heights = as_float("heights", self.heights)
        if heights.ndim != 2 or min(heights.shape) < 2 or heights.size >= 2**31:
            refuse("heights", "at least 2 rows and 2 columns, and fewer than 2**31 posts", f"shape {heights.shape}")
        for name, spacing in (("dn", self.dn), ("de", self.de)):
            if is_concrete(spacing) and not (np.ndim(spacing) == 0 and 0 < float(spacing) < np.inf):
                refuse(name, "a positive distance in meters", spacing)
        option("interpolation", self.interpolation, tuple(_LOOK_UPS))
        option("beyond", self.beyond, ("edge", "void"))
        object.__setattr__(self, "heights", heights)

    @property
    def size(self) -> tuple[Any, Any]:
        """Extent of the map to the north and to the east, meters."""
        return (self.heights.shape[0] - 1) * self.dn, (self.heights.shape[1] - 1) * self.de

    def height(self, north: Any, east: Any) -> jax.Array:
        """Return heights, meters.

        Args:
            north: meters north of the south-west post, any shape.
            east: meters east of it, a shape that broadcasts with `north`.
        """
        row, column = self._cells(north, east)
        return self._known(row, column, _HEIGHTS[self.interpolation](self.heights, row, column))

    def gradient(self, north: Any, east: Any) -> tuple[jax.Array, jax.Array]:
        """Return the slopes to the north and to the east (meters per meter), shaped as `height` returns."""
        return self.height_and_gradient(north, east)[1]

    def height_and_gradient(self, north: Any, east: Any) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        """Return heights and the two slopes from one look-up; arguments as for `height`."""
        row, column = self._cells(north, east)
        height, along_rows, along_columns = _LOOK_UPS[self.interpolation](self.heights, row, column)
        return self._known(row, column, height), (along_rows / self.dn, along_columns / self.de)

    def inside(self, north: Any, east: Any) -> jax.Array:
        """Tell which positions lie within the outermost posts; arguments as for `height`."""
        return self._within(*self._cells(north, east))

    def to_local(self, latitude: Any, longitude: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return meters north and east of the south-west post for map coordinates, in float64 on the host.

        Args:
            latitude: degrees, or northings in meters where the map is a projected one; any shape.
            longitude: degrees, or eastings in meters.
        """
        north = (np.asarray(latitude, np.float64) - self.origin[0]) * self.scale[0]
        return north, (np.asarray(longitude, np.float64) - self.origin[1]) * self.scale[1]

    def to_geographic(self, north: Any, east: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return map coordinates for meters north and east: the inverse of `to_local`, in float64 on the host."""
        latitude = self.origin[0] + np.asarray(north, np.float64) / self.scale[0]
        return latitude, self.origin[1] + np.asarray(east, np.float64) / self.scale[1]

    def _cells(self, north: Any, east: Any) -> tuple[jax.Array, jax.Array]:
        row, column = jnp.broadcast_arrays(jnp.asarray(north) / self.dn, jnp.asarray(east) / self.de)
        return row, column

    def _within(self, row: jax.Array, column: jax.Array) -> jax.Array:
        rows, columns = self.heights.shape
        return (row >= 0) & (row <= rows - 1) & (column >= 0) & (column <= columns - 1)

    def _known(self, row: jax.Array, column: jax.Array, height: jax.Array) -> jax.Array:
        return height if self.beyond == "edge" else jnp.where(self._within(row, column), height, jnp.nan)


def terrain_map(raster: Raster, latitude: float | None = None, interpolation: str = "bilinear") -> TerrainMap:
    """Lay a raster into a local metric frame.

    A geographic raster is flattened: one degree of latitude and one of longitude get the lengths they have on the
    WGS 84 ellipsoid at one latitude. On a tile of one degree the east-west distance at the northern
    and southern edges is then off by about 0.9 percent times the tangent of the latitude.

    Args:
        raster: heights with row 0 in the north.
        latitude: where lengths are exact, degrees; the raster's mean latitude if not given.
        interpolation: "bilinear" or "cubic".

    Returns:
        The map, float64 where JAX computes in 64 bits and float32 otherwise.
    """
    dn, de = raster.spacing_m(latitude)
    scale = (dn / raster.dy, de / raster.dx)
    heights = jnp.asarray(np.ascontiguousarray(raster.heights[::-1]), dtype=jnp.result_type(float))
    return TerrainMap(heights, dn, de, (raster.south, raster.west), scale, interpolation, latitude=raster.latitude)


def _cell(position: jax.Array, count: int) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the index of the cell, the fraction within it, and whether the position is within the grid."""
    clamped = jnp.clip(position, 0, count - 1)
    index = jnp.clip(jnp.floor(clamped).astype(jnp.int32), 0, count - 2)
    return index, clamped - index, (position >= 0) & (position <= count - 1)


def _weighted(weight: jax.Array, value: jax.Array) -> jax.Array:
    # a void does no harm where its weight is zero, as on a line of posts
    return jnp.where(weight == 0, 0, weight * value)


def _corners(heights: jax.Array, row: jax.Array, column: jax.Array) -> tuple[jax.Array, ...]:
    columns = heights.shape[1]
    flat, first = heights.reshape(-1), row * columns + column
    return tuple(flat.at[first + step].get(mode="promise_in_bounds") for step in (0, 1, columns, columns + 1))


@partial(jax.jit, inline=True)
def _look_up(heights: jax.Array, row: jax.Array, column: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return height and slopes per cell at positions given in cells."""
    i, a, row_inside = _cell(row, heights.shape[0])
    j, b, column_inside = _cell(column, heights.shape[1])
    sw, se, nw, ne = _corners(heights, i, j)
    south, north = _weighted(1 - b, sw) + _weighted(b, se), _weighted(1 - b, nw) + _weighted(b, ne)
    height = _weighted(1 - a, south) + _weighted(a, north)
    along_columns = _weighted(1 - a, se - sw) + _weighted(a, ne - nw)
    return height, jnp.where(row_inside, north - south, 0), jnp.where(column_inside, along_columns, 0)


@partial(jax.jit, inline=True)
def _look_up_cubic(heights: jax.Array, row: jax.Array, column: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return height and slopes per cell at positions given in cells, slopes without jumps."""
    rows, columns = heights.shape
    i, a, row_inside = _cell(row, rows)
    j, b, column_inside = _cell(column, columns)
    (up, up_slope), (across, across_slope) = _spline(i, a, rows), _spline(j, b, columns)
    height = along_rows = along_columns = jnp.zeros_like(a)
    flat = heights.reshape(-1)
    for m in range(4):
        level = change = jnp.zeros_like(b)
        for k in range(4):
            place = jnp.clip(i + (m - 1), 0, rows - 1) * columns + jnp.clip(j + (k - 1), 0, columns - 1)
            post = flat.at[place].get(mode="promise_in_bounds")
            level, change = level + _weighted(across[k], post), change + _weighted(across_slope[k], post)
        height, along_rows = height + _weighted(up[m], level), along_rows + _weighted(up_slope[m], level)
        along_columns += _weighted(up[m], change)
    return height, jnp.where(row_inside, along_rows, 0), jnp.where(column_inside, along_columns, 0)


def _spline(index: jax.Array, s: jax.Array, count: int) -> tuple[list[jax.Array], list[jax.Array]]:
    """Return the weights of the posts before, at, after and beyond a cell at the fraction s of it, and their slopes."""
    weights = [((2 - s) * s - 1) * s / 2, ((3 * s - 5) * s * s + 2) / 2, ((4 - 3 * s) * s + 1) * s / 2, (s - 1) * s * s / 2]
    slopes = [((4 - 3 * s) * s - 1) / 2, (9 * s - 10) * s / 2, ((8 - 9 * s) * s + 1) / 2, (3 * s - 2) * s / 2]
    return _straight_on(weights, index, count), _straight_on(slopes, index, count)


def _straight_on(weights: list[jax.Array], index: jax.Array, count: int) -> list[jax.Array]:
    """Give the weights of posts that a grid lacks, on the line through the last two, to those two."""
    before, near, far, beyond = weights
    first, last = jnp.where(index == 0, before, 0), jnp.where(index == count - 2, beyond, 0)
    return [before - first, near + 2 * first - last, far + 2 * last - first, beyond - last]


def _differentiable(look_up: Callable[..., tuple[jax.Array, jax.Array, jax.Array]]) -> Callable[..., jax.Array]:
    """Return the height of a look-up, which has its slopes for derivatives."""

    @jax.custom_jvp
    def height(heights: jax.Array, row: jax.Array, column: jax.Array) -> jax.Array:
        return look_up(heights, row, column)[0]

    @partial(height.defjvp, symbolic_zeros=True)
    def height_jvp(primals: tuple[jax.Array, ...], tangents: tuple[Any, ...]) -> tuple[jax.Array, Any]:
        # written out because the derivative of the masked weights would be wrong on the lines of posts
        heights, row, column = primals
        value, along_rows, along_columns = look_up(heights, row, column)
        change = jnp.zeros_like(value)
        zero = jax.custom_derivatives.SymbolicZero
        for slope, tangent in ((along_rows, tangents[1]), (along_columns, tangents[2])):
            if not isinstance(tangent, zero):
                change += slope * tangent
        if not isinstance(tangents[0], zero):
            change += height(tangents[0], row, column)
        return value, change

    return height


_LOOK_UPS = {"bilinear": _look_up, "cubic": _look_up_cubic}
_HEIGHTS = {name: _differentiable(look_up) for name, look_up in _LOOK_UPS.items()}
