"""Small-matrix algebra with the particle axis last: `(i, j)` for one matrix, `(i, j, n)` for one per particle.

Loops over the small axes are written out at trace time, so that each line of the compiled program runs over all particles. Operands
with and without the particle axis mix freely; a result has the axis when an operand has it.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import Precision

from motes.core import engine, lapack

_EXACT = Precision.HIGHEST
_MOST_ENTRIES = 256
_FEW_ROWS = 8
"""Up to so many rows one triangle, entry by entry, takes half the time of whole columns; beyond, it takes compilers long."""


def _align(a: jax.Array, b: jax.Array, small_axes: int) -> tuple[jax.Array, jax.Array]:
    """Give both the particle axis if one has it; `small_axes` counts the axes before it in b."""
    batched = a.ndim == 3 or b.ndim == small_axes + 1
    if batched and a.ndim == 2:
        a = a[..., None]
    if batched and b.ndim == small_axes:
        b = b[..., None]
    return a, b


def product(a: jax.Array, b: jax.Array) -> jax.Array:
    """A B: `(i, j, *n)` and `(j, k, *n)` give `(i, k, *n)`."""
    if a.ndim == 2:
        return jnp.tensordot(a, b, 1, precision=_EXACT)
    a, b = _align(a, b, 2)
    start = jnp.zeros((a.shape[0], *b.shape[1:]), a.dtype)
    return total([a[:, j, None] * b[j, None] for j in range(a.shape[1])], start)


def product_transposed(a: jax.Array, b: jax.Array) -> jax.Array:
    """A B': `(i, j, *n)` and `(k, j, *n)` give `(i, k, *n)`."""
    if a.ndim == 2:
        return jnp.tensordot(a, b, (1, 1), precision=_EXACT)
    a, b = _align(a, b, 2)
    start = jnp.zeros((a.shape[0], b.shape[0], *b.shape[2:]), a.dtype)
    return total([a[:, j, None] * b[None, :, j] for j in range(a.shape[1])], start)


def times_vector(a: jax.Array, v: jax.Array) -> jax.Array:
    """A v: `(i, j, *n)` and `(j, *n)` give `(i, *n)`."""
    if a.ndim == 2:
        thin = v.ndim == 2 and 0 < a.size <= _MOST_ENTRIES
        return _by_rows(a, v) if thin and engine.accelerated() else jnp.matmul(a, v, precision=_EXACT)
    a, v = _align(a, v, 1)
    start = jnp.zeros((a.shape[0], *v.shape[1:]), a.dtype)
    return total([a[:, j] * v[j] for j in range(a.shape[1])], start)


def _by_rows(a: jax.Array, v: jax.Array) -> jax.Array:
    """A v row by row: libraries for accelerators take twice as long over so thin a product. The barrier makes one kernel of the rows."""
    rows = [total([a[i, j] * v[j] for j in range(a.shape[1])], v[0]) for i in range(a.shape[0])]
    return jnp.stack(jax.lax.optimization_barrier(rows))


def total(terms: list[jax.Array], start: jax.Array) -> jax.Array:
    """Sum of terms, `start` where there are none; written out, since compilers hand small sums over to libraries, which is slower."""
    return sum(terms[1:], terms[0]) if terms else start


def transpose(a: jax.Array) -> jax.Array:
    """A': `(i, j, *n)` gives `(j, i, *n)`."""
    return jnp.swapaxes(a, 0, 1)


def add(a: jax.Array, b: jax.Array) -> jax.Array:
    """A + B for matrices, either with a particle axis or without."""
    a, b = _align(a, b, 2)
    return a + b


def add_vectors(a: jax.Array, b: jax.Array) -> jax.Array:
    """A + b for vectors `(i,)` or `(i, n)`."""
    if a.ndim == b.ndim:
        return a + b
    return a[:, None] + b if a.ndim < b.ndim else a + b[:, None]


def symmetric(a: jax.Array) -> jax.Array:
    """Mean of a matrix and its transpose: takes out the asymmetry that rounding leaves."""
    return 0.5 * (a + transpose(a))


def sandwich(a: jax.Array, p: jax.Array) -> jax.Array:
    """A P A', symmetric up to one rounding for symmetric P."""
    left = product(a, p)
    if left.ndim == 2:
        return mirrored(product_transposed(left, a))
    left = jax.lax.optimization_barrier(left)  # compilers would work it out again for every entry that uses it
    if not (0 < a.shape[0] <= _FEW_ROWS and a.shape[1]):
        return mirrored(product_transposed(left, a))
    rows, right = range(a.shape[0]), a if a.ndim == 3 else a[..., None]
    lower = [[total([left[i, j] * right[k, j] for j in range(a.shape[1])], left[0, 0]) for k in range(i + 1)] for i in rows]
    return jnp.stack([jnp.stack([lower[max(i, k)][min(i, k)] for k in rows]) for i in rows])


def mirrored(a: jax.Array) -> jax.Array:
    """Lower triangle twice, not the mean of both: compilers contract the sums in a mean differently for an entry and its mirror image."""
    lower = np.tri(a.shape[0], dtype=bool)
    return jnp.where(lower if a.ndim == 2 else lower[..., None], a, transpose(a))


def reach(a: jax.Array, deviations: jax.Array) -> jax.Array:
    """Standard deviations `(i, *n)` of A x where all terms of the sums add up: what rounding of A x is a share of.

    Args:
        a: A, `(i, j, *n)`.
        deviations: standard deviations of x, `(j, *n)`.
    """
    return times_vector(jnp.abs(a), deviations)


def rank_update(p: jax.Array, v: jax.Array, scale: jax.Array | float = 1.0) -> jax.Array:
    """P + s v v' for v `(i, *n)` and s `()` or `(n,)`, negative to take away; symmetric up to one rounding for symmetric P."""
    return mirrored(add(p, v[:, None] * v[None, :] * scale))


def identity_like(a: jax.Array) -> jax.Array:
    """Identity matrix `(i, i)` of the size and type of a."""
    return jnp.eye(a.shape[0], dtype=a.dtype)


def take(a: jax.Array, indices: Sequence[int], axis: int = 0) -> jax.Array:
    """Pick rows (or columns, by the axis) at indices known now, as slices, which compilers fuse with what follows; a gather they do not."""
    slices = [jax.lax.slice_in_dim(a, first, end, axis=axis) for first, end in _runs(indices)]
    return jnp.concatenate(slices or [jax.lax.slice_in_dim(a, 0, 0, axis=axis)], axis=axis)


def put(a: jax.Array, rows: jax.Array, indices: Sequence[int], axis: int = 0) -> jax.Array:
    """Exchange rows (or columns, by the axis) at increasing indices known now, as slices; see `take`."""
    slices, at, used = [], 0, 0
    for first, end in _runs(indices):
        new = jax.lax.slice_in_dim(rows, used, used + end - first, axis=axis)
        slices += [jax.lax.slice_in_dim(a, at, first, axis=axis), new]
        at, used = end, used + end - first
    return jnp.concatenate([*slices, jax.lax.slice_in_dim(a, at, a.shape[axis], axis=axis)], axis=axis)


def _runs(indices: Sequence[int]) -> list[list[int]]:
    """Return first and end of each run of indices that follow each other."""
    runs: list[list[int]] = []
    for i in indices:
        if runs and i == runs[-1][1]:
            runs[-1][1] = i + 1
        else:
            runs.append([i, i + 1])
    return runs


def cholesky(a: jax.Array, scale: jax.Array | None = None) -> jax.Array:
    """Lower factor L with L L' = A for positive semi-definite A `(i, i, *n)`.

    A pivot that is zero up to rounding gives a zero column, so that a direction without variance stays exactly without.

    Args:
        a: A.
        scale: size of the terms that made the diagonal, `(i, *n)`, for the rounding that A has; None where it is that of the diagonal.
    """
    size = a.shape[0]
    if size == 0:
        return a
    tolerance = 4 * size * float(jnp.finfo(a.dtype).eps)
    # entry by entry: compilers work slices of columns out again for every column that uses them
    L = [[jnp.zeros_like(a[0, 0])] * size for _ in range(size)]
    for j in range(size):
        pivot = a[j, j] - sum(L[j][k] * L[j][k] for k in range(j))
        alive = pivot > tolerance * (a[j, j] if scale is None else scale[j])
        root = jnp.sqrt(jnp.where(alive, pivot, jnp.inf))  # to divide by infinity leaves a zero column
        L[j][j] = jnp.where(alive, root, 0)
        for i in range(j + 1, size):
            L[i][j] = (a[i, j] - sum(L[i][k] * L[j][k] for k in range(j))) / root
    return jnp.stack([jnp.stack(row) for row in L])


def cholesky_update(lower: jax.Array, v: jax.Array, scale: jax.Array | None = None) -> jax.Array:
    """Lower factor of L L' + V V' for V `(i, m, *n)`, from L with a diagonal that is not negative; neither product is formed.

    One reflection per pivot turns row j of V into the pivot of column j; where both are zero up to rounding nothing is turned.

    Args:
        lower: L, `(i, i, *n)`.
        v: V.
        scale: size of the terms that made each row of L and V, `(i, *n)`, for the rounding that it has; None where it is that of the row.
    """
    if lower.shape[0] == 0 or v.shape[1] == 0:
        return lower
    lower, v = _align(lower, v, 2)
    columns: list[jax.Array] = []
    tolerance = 4 * lower.shape[0] * float(jnp.finfo(lower.dtype).eps)
    scale = jnp.sqrt(jnp.sum(lower**2, axis=1) + jnp.sum(v**2, axis=1)) if scale is None else scale
    least = tolerance * scale
    for j in range(lower.shape[0]):
        column, row = lower[j:, j], v[0]
        pivot = jnp.sqrt(column[0] ** 2 + jnp.sum(row**2, axis=0))
        alive = pivot > least[j]
        inverse = 1 / jnp.where(alive, pivot, 1)
        turned = jnp.where(alive, (column * column[0] + jnp.sum(v * row, axis=1)) * inverse, column)
        reflected = jnp.where(alive, (column + turned) / jnp.where(alive, pivot + column[0], 1), 0)
        v = (v - reflected[:, None] * row)[1:]
        columns.append(turned)
    return _lower(columns)


def triangle(v: jax.Array, scale: jax.Array | None = None) -> jax.Array:
    """Lower factor of V V' for V `(i, m, *n)`; the product is never formed, so that it keeps twice the digits. For scale see above."""
    return cholesky_update(jnp.zeros((v.shape[0], v.shape[0], *v.shape[2:]), v.dtype), v, scale)


def _lower(columns: list[jax.Array]) -> jax.Array:
    """Put columns that start at the diagonal together as a lower triangle."""
    padded = [jnp.concatenate([jnp.zeros((j, *c.shape[1:]), c.dtype), c]) if j else c for j, c in enumerate(columns)]
    return jnp.stack(padded, axis=1)


def unit_factor(a: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Lower L `(i, i, *n)` with ones on its diagonal and d `(i, *n)` with L diag(d) L' = A, for positive semi-definite A `(i, i, *n)`."""
    lower = cholesky(a)
    roots = [lower[i, i] for i in range(lower.shape[0])]
    rows = [[jnp.ones_like(roots[i]) if i == j else lower[i, j] * inverse(root) for j, root in enumerate(roots)]
            for i in range(lower.shape[0])]  # fmt: skip
    return jnp.stack([jnp.stack(row) for row in rows]), jnp.stack(roots) ** 2


def eigen(a: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Eigenvalues `(i, *n)`, in no order, and orthonormal eigenvectors `(i, i, *n)` as columns, of symmetric A `(i, i, *n)`.

    Two rows are turned by one Jacobi rotation; from three on LAPACK does one matrix after the other.
    """
    if a.shape[0] == 1:
        return a[0], jnp.ones_like(a)
    if a.shape[0] != 2:
        return (jax.vmap(lapack.eigen, -1, -1) if a.ndim == 3 else lapack.eigen)(a)
    apart, twice = a[1, 1] - a[0, 0], 2 * a[0, 1]
    square = apart**2 + twice**2
    turned = square > 0
    root = jnp.sqrt(jnp.where(turned, square, 1))
    tangent = jnp.where(turned, jnp.where(apart < 0, -twice, twice) / (jnp.abs(apart) + root), 0)
    cosine = 1 / jnp.sqrt(1 + tangent**2)
    sine = tangent * cosine
    values = jnp.stack([a[0, 0] - tangent * a[0, 1], a[1, 1] + tangent * a[0, 1]])
    return values, jnp.stack([jnp.stack([cosine, sine]), jnp.stack([-sine, cosine])])


def solve_lower(lower: jax.Array, b: jax.Array) -> jax.Array:
    """Solve L z = b for b `(i, *n)` or `(i, j, *n)`; a zero pivot gives a zero component (least effort on a singular factor)."""
    rows: list[jax.Array] = []
    for i in range(lower.shape[0]):
        rest = b[i] - sum(lower[i, j] * row for j, row in enumerate(rows))
        # a vector of each particle's own is divided: compilers work inverses out again for every row that uses one
        own = b.ndim < lower.ndim
        rows.append(rest / jnp.where(lower[i, i] > 0, lower[i, i], jnp.inf) if own else rest * inverse(lower[i, i]))
    return jnp.stack(rows) if rows else b


def solve_upper(lower: jax.Array, b: jax.Array) -> jax.Array:
    """Solve L' z = b with the lower factor L."""
    size = lower.shape[0]
    rows: dict[int, jax.Array] = {}
    for i in reversed(range(size)):
        rest = b[i]
        for j in range(i + 1, size):
            rest = rest - lower[j, i] * rows[j]
        rows[i] = rest * inverse(lower[i, i])
    return jnp.stack([rows[i] for i in range(size)]) if rows else b


def inverse(pivot: jax.Array) -> jax.Array:
    """1 / pivot; 0 where it is not positive, so that a direction without variance does not count."""
    return jnp.where(pivot > 0, 1 / jnp.where(pivot > 0, pivot, 1), 0)


def solve(lower: jax.Array, b: jax.Array) -> jax.Array:
    """Solve (L L') z = b."""
    return solve_upper(lower, solve_lower(lower, b))


def log_determinant(lower: jax.Array) -> jax.Array:
    """Log of the product of the eigenvalues of L L' that are not zero (all of its determinant where it is regular), from the factor.

    With dead pivots, whose rows are M times the others, it is that of the rest times det(1 + M M').
    """
    size = lower.shape[0]
    diagonal = diagonal_of(lower)
    alive = diagonal > 0
    log_pivots = 2 * jnp.sum(jnp.log(jnp.where(alive, diagonal, 1)), axis=0)
    if size < 2:
        return log_pivots
    mixed = jnp.where(alive[None], 0, solve_upper(lower, transpose(lower)))
    whole = diagonal_of(cholesky(add(identity_like(lower), product_transposed(mixed, mixed))))
    return log_pivots + 2 * jnp.sum(jnp.log(whole), axis=0)


def diagonal_of(a: jax.Array) -> jax.Array:
    """Diagonal `(i, *n)` of `(i, i, *n)`."""
    return jnp.stack([a[i, i] for i in range(a.shape[0])]) if a.shape[0] else jnp.zeros((0, *a.shape[2:]), a.dtype)


def block_diagonal(blocks: Sequence[Any]) -> jax.Array:
    """Return the matrix with square blocks along its diagonal, and zeros elsewhere."""
    sizes = [np.shape(block)[0] for block in blocks]
    whole, first = jnp.zeros((sum(sizes),) * 2, jnp.result_type(*blocks)), 0
    for size, block in zip(sizes, blocks, strict=True):
        whole, first = whole.at[first : first + size, first : first + size].set(jnp.asarray(block)), first + size
    return whole
