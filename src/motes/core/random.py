"""The random stream: counter-based, one key per step, one block of numbers for all particles.

Numbers come from Threefry-2x32 with 20 rounds (Salmon et al. 2011), written out so that compilers vectorize it, and both of its
output words are used. The number for particle i in row r depends on the key, i and r alone: not on how many particles there are, nor
on how they are shared out over devices. This is the only file that derives keys.
"""

import hashlib
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import engine
from motes.core.checks import refuse
from motes.core.types import KeyLike

PREDICT, UPDATE, INITIAL, RESAMPLE, NOISE, MEASURE = range(2, 8)
"""Purposes within one step: `child(key, PREDICT)` and so on never share numbers. 0 and 1 are free for laws that need two blocks."""
WORLD, FILTER = 8, 9
"""Purposes within one run of a study."""

_MARKS = np.random.SeedSequence(20041).generate_state(10, np.uint32)

_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
_PARITY = np.uint32(0x1BD11BDA)
_STEP_TAG, _UNIFORM_TAG = np.uint32(0x53544550), np.uint32(0x80000000)
_ROWS_APART = 12
_BELOW_ONE = np.float32(1 - 2**-24)


def as_key(key: KeyLike) -> jax.Array:
    """Return a JAX key from a key or an integer seed of any size.

    Raises:
        MotesError: the key is neither, or belongs to a generator without reproducible counters.
    """
    if _is_seed(key):
        return jax.random.wrap_key_data(jnp.asarray(_seed_words(int(key))), impl="threefry2x32")  # type: ignore[arg-type]
    if isinstance(key, jax.Array) and jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        if "threefry2x32" not in str(jax.random.key_impl(key)):
            refuse("key", "a threefry2x32 key", f"one of {jax.random.key_impl(key)}", "Use jax.random.key(seed) or an int.")
        return key
    if isinstance(key, (jax.Array, np.ndarray)) and key.dtype == np.uint32 and key.shape[-1:] == (2,):
        return jax.random.wrap_key_data(jnp.asarray(key), impl="threefry2x32")
    refuse("key", "a JAX key or an integer seed", repr(type(key).__name__))


def key_or_data(key: KeyLike) -> Any:
    """Return a key as `as_key` does, or of a plain seed its data `(2,)`, which costs a short run less than to ask JAX for the key.

    Raises:
        MotesError: see `as_key`, which takes both.
    """
    return _seed_words(int(key)) if _is_seed(key) else as_key(key)  # type: ignore[arg-type]


def _is_seed(key: object) -> bool:
    return isinstance(key, (int, np.integer)) and not isinstance(key, bool)


def _seed_words(seed: int) -> np.ndarray:
    """Return 64 bits of key, `(2,)`: the seed itself where it fits, as JAX has it in double precision; otherwise a digest of it.

    JAX in single precision keeps the lower 32 bits only, so that 1 and 2^32 + 1 would draw the same numbers.
    """
    if not 0 <= seed < 2**64:
        seed = int.from_bytes(hashlib.sha256(hex(seed).encode()).digest()[:8], "big")
    return np.array([seed >> 32, seed & 0xFFFFFFFF], np.uint32)


def step_key(key: jax.Array, step: jax.Array | int) -> jax.Array:
    """Return the key of one time step, from a key of a run or from keys of all steps `(t,)`."""
    key = key[step] if key.ndim else key
    data = jax.random.key_data(key)
    folded = _threefry(data[0], data[1], jnp.asarray(step).astype(jnp.uint32), jnp.full((), _STEP_TAG))
    return jax.random.wrap_key_data(jnp.stack(folded), impl="threefry2x32")


def step_keys(key: jax.Array, count: int) -> jax.Array:
    """Return the keys of the first steps, or of as many chains or particles, `(count,)`; the k-th does not depend on how many there are."""
    return jax.vmap(lambda step: step_key(key, step))(jnp.arange(count))


def child(key: jax.Array, purpose: int) -> jax.Array:
    """Return the key for one purpose within a step or a run.

    Threefry makes independent numbers from keys that differ in a single bit, so marking the key is enough; the rotation keeps a child of a
    child apart from the children of others.
    """
    data = jax.random.key_data(key)
    rotated = (data[0] << 11) | (data[0] >> 21)
    return jax.random.wrap_key_data(jnp.stack([rotated ^ _MARKS[purpose], data[1] + _MARKS[purpose]]), impl="threefry2x32")


def split(key: jax.Array, n: int) -> jax.Array:
    """Return n keys, for user functions that draw one value at a time (slow: prefer one block of noise)."""
    return jax.random.split(key, n)


def normal(key: jax.Array, shape: tuple[int, ...], dtype: jnp.dtype) -> jax.Array:
    """Draw standard normal numbers, particle axis last.

    float32 reaches 5.4 standard deviations; float64 uses 64 random bits a number.
    """
    rows = int(np.prod(shape[:-1], dtype=np.int64))
    made = jnp.float64 if dtype == jnp.float64 else jnp.float32
    return _normal_numbers(jax.random.key_data(key), rows, shape[-1], made).reshape(shape).astype(dtype)


@partial(jax.jit, static_argnums=(1, 2, 3))
def _normal_numbers(key: jax.Array, rows: int, n: int, dtype: Any) -> jax.Array:
    # a jitted function keeps its name in traced programs, where the native engine looks for it
    return normal_block(key, rows, n, dtype)


@engine.replaceable
def normal_block(key: jax.Array, rows: int, n: int, dtype: Any) -> jax.Array:
    """Draw standard normal numbers `(rows, n)` in float32 or float64 from the data of a key, `(2,)`."""
    if dtype == jnp.float64:
        return jax.lax.optimization_barrier(_to_normal_of_64(*_words(key, (rows, n))))
    pairs = (rows + 1) // 2
    if 0 < pairs <= _ROWS_APART:
        # row by row: compilers then share the rows out over threads, a quarter faster than one block
        lines = [word for pair in range(pairs) for word in _words(key, (n,), np.uint32(pair))]
        return jax.lax.optimization_barrier(jnp.stack([_to_normal(line) for line in lines[:rows]]))
    first, second = _words(key, (pairs, n))
    bits = jnp.stack([first, second], axis=1).reshape(-1, n)[:rows]
    return jax.lax.optimization_barrier(_to_normal(bits))


_LOG = (-0.101022407, 0.164199948, -0.173334658, 0.198730454, -0.249593437, 0.333361834, -0.500006676, 0.999999821)
_NEAR = (2.81022636e-08, 3.43273939e-07, -3.5233877e-06, -4.39150654e-06, 0.00021858087, -0.00125372503, -0.00417768164, 0.246640727,
         1.50140941)  # fmt: skip
_FAR = (-0.000200214257, 0.000100950558, 0.00134934322, -0.00367342844, 0.00573950773, -0.0076224613, 0.00943887047, 1.00167406, 2.83297682)
_SQRT_HALF = np.float32(np.sqrt(0.5)).view(np.int32)


def _to_normal(bits: jax.Array) -> jax.Array:
    """Turn words into normal numbers by the inverse of the error function (Giles 2010), with a logarithm of our own.

    Products and sums are arranged so that there is one way only to fuse them: every device and every engine gets the same numbers, up to
    three units in the last place.
    """
    centered = jax.lax.bitcast_convert_type(bits, jnp.int32).astype(jnp.float32) * np.float32(2.0**-31)
    centered = jnp.clip(centered, -_BELOW_ONE, _BELOW_ONE)
    shifted = jax.lax.bitcast_convert_type((1 - centered) * (1 + centered), jnp.int32) - _SQRT_HALF
    twos = (shifted >> 23).astype(jnp.float32)
    rest = jax.lax.bitcast_convert_type((shifted & 0x007FFFFF) + _SQRT_HALF, jnp.float32) - 1
    log_and_more = twos * np.float32(np.log(2)) + (_polynomial(_LOG, rest) * rest + np.float32(2.5))
    w = np.float32(2.5) - log_and_more
    far = jnp.sqrt(w) - 3
    scale = jnp.where(w < 5, _polynomial(_NEAR, -log_and_more), _polynomial(_FAR, far))
    return np.float32(np.sqrt(2)) * (scale * centered)


def _polynomial(coefficients: tuple[float, ...], x: jax.Array) -> jax.Array:
    value = jnp.full_like(x, coefficients[0])
    for coefficient in coefficients[1:]:
        value = value * x + x.dtype.type(coefficient)
    return value


_LOG_64 = (0.1662237988556164, 0.18140156550162828, 0.2222286313243771, 0.28571424130490974, 0.4000000001123118, 0.6666666666666207, 2.0)
_ABOVE_64 = (6.552278792315236e-18, 8.971775296547198e-15, 1.1463073011495388e-12, 3.3466637848058696e-11, 1.0715689140725503e-09,
             2.3186790497885494e-08, 4.092950831955036e-07, 5.918172496398085e-06, 6.922194356995133e-05, 0.0006511154704441467,
             0.004914311812418407, 0.029358885509827348, 0.13290734025861248, 0.4437462229088739, 0.886226925452758)  # fmt: skip
_BELOW_64 = (3.6503073201934257e-16, 1.278283353555561e-13, 7.145828276360274e-12, 1.7963081207581553e-10, 5.829580201029391e-09,
             9.431982348568857e-08, 1.8027883874053928e-06, 2.0249651161433807e-05, 0.00024332523791208575, 0.0019008001466745822,
             0.013173997886877988, 0.07439013946739667, 0.23891460560855823, 1.0)  # fmt: skip
_BELOW_ONE_64 = 1 - 2.0**-53


def _to_normal_of_64(first: jax.Array, second: jax.Array) -> jax.Array:
    """Turn pairs of words into normal numbers in double precision: `_to_normal` with one fraction for the inverse error function."""
    bits = (first.astype(jnp.uint64) << 32) | second.astype(jnp.uint64)
    centered = jax.lax.bitcast_convert_type(bits, jnp.int64).astype(jnp.float64) * 2.0**-63
    centered = jnp.clip(centered, -_BELOW_ONE_64, _BELOW_ONE_64)
    sqrt_half = np.float64(np.sqrt(0.5)).view(np.int64)
    shifted = jax.lax.bitcast_convert_type((1 - centered) * (1 + centered), jnp.int64) - sqrt_half
    twos = (shifted >> 52).astype(jnp.float64)
    rest = jax.lax.bitcast_convert_type((shifted & 0x000FFFFFFFFFFFFF) + sqrt_half, jnp.float64) - 1
    s = rest / (2 + rest)
    w = -np.log(2) * twos - s * _polynomial(_LOG_64, s * s)
    return np.sqrt(2) * (_polynomial(_ABOVE_64, w) / _polynomial(_BELOW_64, w) * centered)


def uniform(key: jax.Array, shape: tuple[int, ...], dtype: jnp.dtype) -> jax.Array:
    """Draw uniform numbers in [0, 1), particle axis last."""
    rows = int(np.prod(shape[:-1], dtype=np.int64))
    return _uniform_numbers(jax.random.key_data(key), rows, shape[-1] if shape else 1, dtype).reshape(shape).astype(dtype)


@partial(jax.jit, static_argnums=(1, 2, 3))
def _uniform_numbers(key: jax.Array, rows: int, n: int, dtype: jnp.dtype) -> jax.Array:
    first, second = _words(key, (rows, n), _UNIFORM_TAG)
    if dtype == jnp.float64:
        high, low = (first >> 5).astype(dtype), (second >> 6).astype(dtype)
        return (high * 2.0**26 + low) * 2.0**-53
    return (first >> 8).astype(jnp.float32) * np.float32(2.0**-24)


NORMAL, UNIFORM = "_normal_numbers", "_uniform_numbers"
"""Names under which blocks of random numbers stand in traced programs."""


def _words(key: jax.Array, shape: tuple[int, ...], tag: np.uint32 = np.uint32(0)) -> tuple[jax.Array, jax.Array]:  # noqa: B008
    rows = int(np.prod(shape[:-1], dtype=np.int64))
    counters = jnp.arange(shape[-1], dtype=jnp.uint32)[None, :]
    lines = jnp.arange(rows, dtype=jnp.uint32)[:, None] ^ tag
    words = _threefry(key[0], key[1], jnp.broadcast_to(counters, (rows, shape[-1])), lines)
    # without barriers, here and behind the normal numbers, compilers work them out again in every loop that uses them
    first, second = jax.lax.optimization_barrier(words)
    return first.reshape(shape), second.reshape(shape)


def _threefry(key0: jax.Array, key1: jax.Array, counter0: jax.Array, counter1: jax.Array) -> tuple[jax.Array, jax.Array]:
    keys = (key0, key1, key0 ^ key1 ^ _PARITY)
    a, b = counter0 + keys[0], counter1 + keys[1]
    for group in range(5):
        for rotation in _ROTATIONS[group % 2]:
            a = a + b
            b = (b << rotation) | (b >> (32 - rotation))
            b = a ^ b
        a = a + keys[(group + 1) % 3]
        b = b + keys[(group + 2) % 3] + np.uint32(group + 1)
    return a, b
