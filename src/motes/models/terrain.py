"""Terrain as a function of position: bilinear heights and slopes on a grid, ready for jit, vmap and differentiation."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core.checks import as_float, is_concrete, refuse
from motes.core.record import record, static
from motes.io.rasters import Raster


@record
class TerrainMap:
    """A grid of heights in a local metric frame whose origin is the south-west post.

    Positions are meters north and east of that post. Between posts heights are bilinear; slopes jump at the lines
    between cells, where those of the cell to the north and east count. Look-ups beyond the edge take the height of the
    nearest edge and no slope across it; `inside` tells. A look-up that needs a void is NaN.

    Attributes:
        heights: `(rows, columns)`, meters, NaN at voids; row 0 is the SOUTHERNMOST, column 0 the westernmost.
        dn: distance between rows, meters.
        de: distance between columns, meters.
        origin: latitude and longitude (degrees) or northing and easting (meters) of the south-west post.
        scale: meters per unit of those two coordinates.
    """

    heights: jax.Array
    dn: float
    de: float
    origin: tuple[float, float] = static(default=(0.0, 0.0))
    scale: tuple[float, float] = static(default=(1.0, 1.0))

    def __post_init__(self) -> None:
        """Check the grid and the spacing."""
        heights = as_float("heights", self.heights)
        if heights.ndim != 2 or min(heights.shape) < 2 or heights.size >= 2**31:
            refuse("heights", "at least 2 rows and 2 columns, and fewer than 2**31 posts", f"shape {heights.shape}")
        for name, spacing in (("dn", self.dn), ("de", self.de)):
            if is_concrete(spacing) and not (np.ndim(spacing) == 0 and 0 < float(spacing) < np.inf):
                refuse(name, "a positive distance in meters", spacing)
        object.__setattr__(self, "heights", heights)

    @property
    def size(self) -> tuple[Any, Any]:
        """Extent of the map to the north and to the east, meters."""
        return (self.heights.shape[0] - 1) * self.dn, (self.heights.shape[1] - 1) * self.de

    def height(self, north: Any, east: Any) -> jax.Array:
        """Return bilinear heights, meters.

        Args:
            north: meters north of the south-west post, any shape.
            east: meters east of it, a shape that broadcasts with `north`.
        """
        return _height(self.heights, *self._cells(north, east))

    def gradient(self, north: Any, east: Any) -> tuple[jax.Array, jax.Array]:
        """Return the slopes to the north and to the east (meters per meter), shaped as `height` returns."""
        return self.height_and_gradient(north, east)[1]

    def height_and_gradient(self, north: Any, east: Any) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        """Return heights and the two slopes from one look-up; arguments as for `height`."""
        height, along_rows, along_columns = _look_up(self.heights, *self._cells(north, east))
        return height, (along_rows / self.dn, along_columns / self.de)

    def inside(self, north: Any, east: Any) -> jax.Array:
        """Tell which positions lie within the outermost posts; arguments as for `height`."""
        row, column = self._cells(north, east)
        rows, columns = self.heights.shape
        return (row >= 0) & (row <= rows - 1) & (column >= 0) & (column <= columns - 1)

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


def terrain_map(raster: Raster, latitude: float | None = None) -> TerrainMap:
    """Lay a raster into a local metric frame.

    A geographic raster is flattened: one degree of latitude and one of longitude get the lengths they have on the
    WGS 84 ellipsoid at one latitude. On a tile of one degree the east-west distance at the northern
    and southern edges is then off by about 0.9 percent times the tangent of the latitude.

    Args:
        raster: heights with row 0 in the north.
        latitude: where lengths are exact, degrees; the raster's mean latitude if not given.

    Returns:
        The map, float64 where JAX computes in 64 bits and float32 otherwise.
    """
    dn, de = raster.spacing_m(latitude)
    scale = (dn / raster.dy, de / raster.dx)
    heights = jnp.asarray(np.ascontiguousarray(raster.heights[::-1]), dtype=jnp.result_type(float))
    return TerrainMap(heights, dn, de, (raster.south, raster.west), scale)


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


@jax.custom_jvp
def _height(heights: jax.Array, row: jax.Array, column: jax.Array) -> jax.Array:
    return _look_up(heights, row, column)[0]


@partial(_height.defjvp, symbolic_zeros=True)
def _height_jvp(primals: tuple[jax.Array, ...], tangents: tuple[Any, ...]) -> tuple[jax.Array, Any]:
    # written out because the derivative of the masked weights would be wrong on the lines of posts
    heights, row, column = primals
    height, along_rows, along_columns = _look_up(heights, row, column)
    change = jnp.zeros_like(height)
    zero = jax.custom_derivatives.SymbolicZero
    for slope, tangent in ((along_rows, tangents[1]), (along_columns, tangents[2])):
        if not isinstance(tangent, zero):
            change += slope * tangent
    if not isinstance(tangents[0], zero):
        change += _height(tangents[0], row, column)
    return height, change
