"""Which plot is whose, where nobody says it: sums over all associations of plots with targets (Bar-Shalom, Li 1995, section 6.2).

Each target has at most one plot, each plot is of one target at most or nobody's. Plots are taken one after the other; for each set S of
targets F(S) sums over the associations in which those of S have a plot by now:
F(S) <- F(S) false(z_j) + sum over i in S of F(S without i) hit(i, z_j). That is exact, at the cost of T 2^(T - 1) sums a plot.

Of more targets than that can be done for, belief propagation says nearly the same (Williams, Lau 2014): messages between targets and plots,
mu(i, j) = hit(i, j) / (miss(i) + sum over other plots of hit nu) and nu(i, j) = 1 / (false(j) + sum over other targets of mu), which always
converge, and are exact where plots and targets that can belong together form a tree.
"""

from collections.abc import Iterable

import jax
import jax.numpy as jnp

EXACT = 6
"""Targets whose associations are summed over; each more doubles the work."""
ROUNDS = 60
"""Of messages."""
HARDLY = -4e4
"""What stands for the log of the impossible in messages: beside it hundredths of a nat are seen in single precision, too."""
NEVER = -1e30
"""Log of what is impossible, finite so that derivatives of sums of it are zero."""


def missed(probability: jax.Array, never: float = NEVER) -> jax.Array:
    """Log probability of no plot, of targets seen with some probability; `never` of those that are always seen, with derivative zero."""
    always = probability >= 1
    return jnp.where(always, never, jnp.log1p(-jnp.where(always, 0, probability)))


def gained(gains: jax.Array, log_density: jax.Array) -> jax.Array:
    """Log of what a plot brings if it is a target's, given its log density; `NEVER` where there is no plot."""
    return jnp.where(jnp.isfinite(gains), gains + log_density, NEVER)


def associated(hits: jax.Array, misses: jax.Array, false: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Sum over all associations, and say how probable it is of each of m targets that a plot is its own.

    Args:
        hits: log of what each plot brings if it is a target's, `(m, K, *n)`.
        misses: log probability of no plot of a target, `(m, *n)`.
        false: log of what each plot brings if it is nobody's, `(K,)`.

    Returns:
        The log of the sum `(*n)`, and of each target the probabilities of no plot and of each `(m, 1 + K, *n)`.
    """
    return (_summed if len(hits) <= EXACT else _by_messages)(hits, misses, false)


def _summed(hits: jax.Array, misses: jax.Array, false: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Do what `associated` says, exactly.

    The sum is linear in what a target makes of a plot, so that its logarithm's derivative by that of the term is the term's share.
    """

    def total(hits: jax.Array, misses: jax.Array) -> tuple[jax.Array, jax.Array]:
        def plot(totals: jax.Array, now: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
            return with_plot(totals, *now), None

        start = nobody(len(hits), misses.shape[1:], misses.dtype)
        found = whole(jax.lax.scan(plot, start, (jnp.swapaxes(hits, 0, 1), false))[0], misses)
        return jnp.sum(jnp.where(jnp.isfinite(found), found, 0)), found

    (_, found), (of_plots, of_none) = jax.value_and_grad(total, (0, 1), has_aux=True)(hits, misses)
    return found, jnp.concatenate([of_none[:, None], of_plots], axis=1)


def _by_messages(hits: jax.Array, misses: jax.Array, false: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Do what `associated` says, by belief propagation, in logarithms: what hardly any association allows is far below any power of two."""
    top = jnp.maximum(jnp.max(hits, axis=1, initial=NEVER), misses)
    hit, miss = hits - top[:, None], jnp.maximum(misses - top, HARDLY)[:, None]
    nobodys = jnp.maximum(false, HARDLY).reshape(-1, *[1] * (hits.ndim - 2))

    def to_plots(of_plots: jax.Array) -> jax.Array:
        return hit - jnp.logaddexp(miss, _others(hit + of_plots, 1))

    def round_of(_: int, of_plots: jax.Array) -> jax.Array:
        return -jnp.logaddexp(nobodys, _others(to_plots(of_plots), 0))

    of_plots = jax.lax.fori_loop(0, ROUNDS, round_of, jnp.zeros_like(hit))
    of_targets = to_plots(of_plots)
    each = jnp.concatenate([miss, hit + of_plots], axis=1)
    rows = jax.nn.logsumexp(each, axis=1)
    # the sum by Bethe's free energy, beside that of the likeliest plot of each target
    total = jnp.sum(rows, axis=0) + jnp.sum(jnp.logaddexp(nobodys, jax.nn.logsumexp(of_targets, axis=0)), axis=0)
    total = total - jnp.sum(jax.nn.softplus(of_targets + of_plots), axis=(0, 1))
    return jnp.where(total < 0.5 * HARDLY, -jnp.inf, jnp.sum(top, axis=0) + total), jnp.exp(each - rows[:, None])


def _others(values: jax.Array, axis: int) -> jax.Array:
    """Log of the sum over all others along an axis; not the whole less each, which would be rounding where one is most of it."""
    none = jnp.full_like(jax.lax.slice_in_dim(values, 0, 1, axis=axis), NEVER)

    def before(values: jax.Array) -> jax.Array:
        sums = jax.lax.cumlogsumexp(jnp.concatenate([none, values], axis), axis=axis)
        return jax.lax.slice_in_dim(sums, 0, values.shape[axis], axis=axis)

    return jnp.logaddexp(before(values), jnp.flip(before(jnp.flip(values, axis)), axis))


def nobody(count: int, shape: tuple[int, ...], dtype: jnp.dtype) -> jax.Array:
    """Return the sums `(2^T, *n)` before the first plot, as logs."""
    return jnp.full((2**count, *shape), NEVER, dtype).at[0].set(0)


def with_plot(totals: jax.Array, hits: Iterable[jax.Array], false: jax.Array) -> jax.Array:
    """Take one more plot into the sums `(2^T, *n)` over associations, by the set of targets that have a plot, as the bits of its number.

    Args:
        totals: before.
        hits: of each target, what it brings if the plot is its own, `(*n)`.
        false: what it brings if it is nobody's, `()`.
    """
    found = totals + false
    for i, hit in enumerate(hits):
        # sets without target i, and those with it
        before = totals.reshape(-1, 2, 2**i, *totals.shape[1:])
        without, having = jnp.moveaxis(found.reshape(before.shape), 1, 0)
        found = jnp.stack([without, jnp.logaddexp(having, before[:, 0] + hit)], axis=1).reshape(totals.shape)
    return found


def whole(totals: jax.Array, misses: Iterable[jax.Array]) -> jax.Array:
    """Sum `(2^T, *n)` over the sets of targets that have a plot; those that have none are missed."""
    found = jax.nn.logsumexp(jnp.stack([
        total + sum(miss for i, miss in enumerate(misses) if not taken >> i & 1) for taken, total in enumerate(totals)
    ]), axis=0)  # fmt: skip
    return jnp.where(found < 0.5 * NEVER, -jnp.inf, found)
