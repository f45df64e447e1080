"""What is learned of a target on the way, carried by `Adapting`.

Boosted features of boxes on it and beside it, in the first picture and in the last few in which it was seen for sure; its colours; and
where and how large it was when it was last seen so.

1. The score of the estimate is worked out.
2. Where it is high, boxes on the target and beside it take the place of the oldest ones, and the ensemble is boosted anew.
"""

from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp

from motes.applications.video.boosting import boosted
from motes.applications.video.colour import distance, histograms
from motes.applications.video.features import pool, values
from motes.applications.video.model import Look, sides

FIRST, LATER = (64, 160), (16, 48)
"""Boxes on the target and beside it, of the first picture and of each later one."""
BARE = 16
"""Boxes with nothing in them, all of whose features are 0, among those beside the target in the first picture: what may hide it is often
as bare as a wall, and shown nowhere in that picture."""
RECENT = 8
"""Later pictures that are remembered."""
OLD = 0.5
"""What the first picture counts for beside the later ones."""
SURE = 0.2
"""Score above which is learned from a picture."""
FADING = 0.3
"""What a picture counts for in what is usual."""
NEAR = 0.04
"""Standard deviation of boxes on the target, as a share of it."""
BESIDE, SIZES = (0.35, 1.55), (0.65, 1.4)
"""How far off boxes lie beside it, in boxes; and the sizes of the third of them that are in place, but too small or too large."""


@partial(jax.jit, static_argnames="look")
def first_memory(key: jax.Array, look: Look, y: Any, start: jax.Array, aspect: jax.Array) -> dict[str, jax.Array]:
    """Learn from the first picture.

    Args:
        key: of the boxes beside the target.
        look: how it is looked at.
        y: the measurement.
        start: state of the target, `(3,)`.
        aspect: width of the target over its height, `()`.
    """
    box = {"aspect": aspect}
    found = _examples(key, look, y, start, box, FIRST).at[:, -BARE:].set(0)
    later = jnp.zeros((found.shape[0], RECENT, sum(LATER)), found.dtype)
    memory = {"first": found, "later": later, "learned": jnp.int32(0), "score": jnp.ones((), found.dtype), "seen": start, **box,
              **dict.fromkeys(("colour", "original", "recent"), histograms(y["bins"], look.boxes(start[:, None], box))[0])}  # fmt: skip
    memory |= _boosted(memory)
    return {**memory, "usual": look.log_likelihood(y, start[:, None], memory)[0]}


@cache
def learning(look: Look, learns: bool) -> Any:
    """Return how the memory changes, as `Adapting` asks for it; with `learns` false only the score does.

    The same for equal arguments, so that nothing is compiled twice.
    """

    def learn(key: jax.Array, memory: Any, law: Any, y: Any, u: Any, t: Any) -> dict[str, jax.Array]:
        mean = law.mean()
        score = look.score(y, mean[:, None], memory)[0]
        sure = score > SURE
        present = {"usual": look.log_likelihood(y, mean[:, None], memory)[0],
                   "recent": histograms(y["bins"], look.boxes(mean[:, None], memory))[0]}  # fmt: skip
        faded = {name: memory[name] + FADING * (new - memory[name]) for name, new in present.items()}
        memory = {**memory, "score": score} | {name: jnp.where(sure, new, memory[name]) for name, new in {"seen": mean, **faded}.items()}
        if not learns:
            return memory

        def anew() -> dict[str, jax.Array]:
            place = memory["learned"] % RECENT
            later = memory["later"].at[:, place].set(_examples(key, look, y, mean, memory, LATER))
            # the colours of the first picture count for as much as they are still there
            stays = 1 - distance(memory["original"], memory["recent"])
            colour = stays * memory["original"] + (1 - stays) * memory["recent"]
            changed = {**memory, "later": later, "learned": memory["learned"] + 1, "colour": colour}
            return {**changed, **_boosted(changed)}

        return jax.lax.cond(sure, anew, lambda: memory)

    return learn


def _boosted(memory: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """Return the ensemble of all examples."""
    count = jnp.minimum(memory["learned"], RECENT)
    share = jnp.where(jnp.arange(RECENT) < count, (1 - OLD) / jnp.maximum(count, 1), 0.0)

    def each(weight: Any, sizes: tuple[int, int]) -> tuple[jax.Array, jax.Array]:
        target = jnp.arange(sum(sizes)) < sizes[0]
        weights = weight / jnp.where(target, sizes[0], sizes[1])
        return jnp.broadcast_to(target, weights.shape).ravel(), weights.ravel()

    parts = each(OLD, FIRST), each(share[:, None], LATER)
    target, weights = (jnp.concatenate(both) for both in zip(*parts, strict=True))
    examples = jnp.concatenate([memory["first"], memory["later"].reshape(len(memory["first"]), -1)], axis=1)
    return boosted(examples, target, weights.astype(examples.dtype))._asdict()


def _examples(key: jax.Array, look: Look, y: Any, state: jax.Array, memory: Any, count: tuple[int, int]) -> jax.Array:
    """Return features `(150, m)` of boxes on the target, and after them of boxes beside it."""
    near, beside = count
    keys = jax.random.split(key, 4)
    side = sides(state[2], memory)
    close = NEAR * jax.random.normal(keys[0], (3, near))
    angle = jax.random.uniform(keys[1], (beside,), maxval=2 * jnp.pi)
    far = jax.random.uniform(keys[2], (beside,), minval=BESIDE[0], maxval=BESIDE[1])
    away = far * jnp.stack([jnp.cos(angle), jnp.sin(angle), jnp.zeros(beside)])
    third = jnp.arange(beside) % 3 == 0
    sized = jnp.log(jnp.array(SIZES))[jnp.arange(beside) // 3 % 2] * jnp.array([[0.0], [0.0], [1.0]])
    moves = jnp.concatenate([close, jnp.where(third, sized, away)], axis=1)
    scale = jnp.concatenate([side, jnp.ones(1)])
    return values(y["sums"], look.boxes(state[:, None] + scale[:, None] * moves, memory), pool())
