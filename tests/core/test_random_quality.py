"""Quality of the random stream: every test judges at the level 1e-6, and is shown to reject a generator that is broken on purpose."""

import json
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2, kstest, norm, poisson

from motes.core import engine, random

LEVEL = 1e-6
ROWS, N = 8, 1 << 17
KEY = 20_041
FACTORIALS = (1, 0, 1, 0, 3, 0, 15, 0, 105, 0, 945, 0, 10_395)
"""Moments of the standard normal law by order."""


def words(key=KEY, rows=ROWS, n=N):
    """Both output words of the block cipher, `(2, rows, n)`."""
    return np.stack([np.asarray(word) for word in random._words(jax.random.key_data(random.as_key(key)), (rows, n))])


def numbers(key=KEY):
    return np.asarray(random.normal(random.as_key(key), (ROWS, N), jnp.dtype("float32")), np.float64)


def two_sided(z):
    """Level at which the largest of normal scores is judged."""
    z = np.abs(np.ravel(z))
    return min(1.0, z.size * 2 * norm.sf(z.max()))


def moments():
    z = numbers()
    scores = [(np.mean(z**k, axis=1) - FACTORIALS[k]) * np.sqrt(N / (FACTORIALS[2 * k] - FACTORIALS[k] ** 2)) for k in range(1, 7)]
    return two_sided(scores)


def law():
    return min(1.0, ROWS * min(kstest(row, "norm").pvalue for row in numbers()))


def serial_correlation():
    """Along particles at lags 1 to 64, and between rows at shifts of up to one particle."""
    z = numbers()
    along = [np.mean(z[:, :-lag] * z[:, lag:], axis=1) * np.sqrt(N - lag) for lag in range(1, 65)]
    pairs = [(i, j) for i in range(ROWS) for j in range(i)]
    across = [np.mean(z[i] * np.roll(z[j], shift)) * np.sqrt(N) for i, j in pairs for shift in (-1, 0, 1)]
    return two_sided(np.concatenate([np.ravel(along), across]))


def squares_correlation():
    """Rows may be uncorrelated and yet share their sizes."""
    z = (numbers() ** 2 - 1) / np.sqrt(2)
    return two_sided([np.mean(z[i] * z[j]) * np.sqrt(N) for i in range(ROWS) for j in range(i)])


def cross_stream_correlation():
    """Numbers of neighboring seeds, steps and purposes."""
    key = random.as_key(KEY)
    keys = [random.as_key(KEY + 1), random.as_key(KEY ^ (1 << 20)), *(random.step_key(key, t) for t in (0, 1, 2)),
            *(random.child(key, purpose) for purpose in range(8)), key]
    z = np.stack([np.asarray(random.normal(k, (1, N), jnp.dtype("float32")), np.float64)[0] for k in keys])
    return two_sided((z @ z.T / np.sqrt(N))[np.tril_indices(len(keys), -1)])


def bit_frequencies():
    bits = _bits()
    return two_sided((bits.mean(axis=-1) - 0.5) * 2 * np.sqrt(bits.shape[-1]))


def bit_pairs():
    """Every pair of the 64 bits of the two words of one counter."""
    signs = 2.0 * _bits() - 1
    return two_sided((signs @ signs.T / np.sqrt(signs.shape[-1]))[np.tril_indices(64, -1)])


def _bits():
    block = words(rows=1).reshape(2, -1)
    return np.stack([(word >> np.uint32(bit)) & np.uint32(1) for word in block for bit in range(32)]).astype(np.float64)


def avalanche():
    """Neighboring counters differ in one bit and more; half of the bits of the words must differ, independently."""
    block = words(rows=1).reshape(2, -1)
    flips = np.stack([np.unpackbits((word[1:] ^ word[:-1]).view(np.uint8)).reshape(-1, 32).sum(axis=1) for word in block])
    return two_sided((flips.mean(axis=1) - 16) / np.sqrt(8 / flips.shape[1]))


def runs():
    """Number of runs above and below the median (Wald and Wolfowitz), with the median known."""
    changes = np.diff(numbers() > 0, axis=1).sum(axis=1)
    return two_sided((changes - (N - 1) / 2) / np.sqrt((N - 1) / 4))


def birthday_spacings():
    """Collisions among the spacings of 2^9 birthdays in a year of 2^24 days are nearly Poisson (Marsaglia); each word, many years."""
    born = np.sort((words() >> np.uint32(8)).astype(np.int64).reshape(-1, 1 << 9), axis=1)
    spacings = np.sort(np.diff(born, axis=1), axis=1)
    total, mean = int((np.diff(spacings, axis=1) == 0).sum()), born.shape[0] * (1 << 9) ** 3 / (4 * (1 << 24))
    return min(1.0, 2 * min(poisson.cdf(total, mean), poisson.sf(total - 1, mean)))


def gaps():
    """Distances between visits to the top eighth are geometric."""
    visits = np.flatnonzero(words()[0].ravel() >> np.uint32(29) == 7)
    if visits.size < 2:
        return 0.0
    found = np.bincount(np.minimum(np.diff(visits) - 1, 60), minlength=61)
    expected = np.append(0.875 ** np.arange(60) / 8, 0.875**60) * found.sum()
    return chi2.sf(((found - expected) ** 2 / expected).sum(), 60)


TESTS = (moments, law, serial_correlation, squares_correlation, cross_stream_correlation, bit_frequencies, bit_pairs, avalanche, runs,
         birthday_spacings, gaps)


def few_rounds(key0, key1, counter0, counter1):
    """Two rounds of Threefry."""
    a, b = counter0 + key0, counter1 + key1
    for rotation in (13, 15):
        a = a + b
        b = a ^ ((b << rotation) | (b >> (32 - rotation)))
    return a + key1, b + (key0 ^ key1 ^ random._PARITY)


def reused_word(key0, key1, counter0, counter1):
    a, _ = TRUE(key0, key1, counter0, counter1)
    return a, a


def odd_rows_equal(key0, key1, counter0, counter1):
    return TRUE(key0, key1, counter0, counter1 & ~jnp.uint32(1))


TRUE = random._threefry
BROKEN = {
    few_rounds: (moments, law, serial_correlation, bit_pairs, birthday_spacings, gaps),
    reused_word: (serial_correlation, squares_correlation, bit_pairs),
    odd_rows_equal: (serial_correlation, squares_correlation),
}


@pytest.mark.parametrize("test", TESTS, ids=lambda test: test.__name__)
def test_stream_is_accepted(test):
    assert test() > LEVEL


@pytest.mark.parametrize(("broken", "test"), [(b, test) for b, tests in BROKEN.items() for test in tests], ids=lambda f: f.__name__)
def test_broken_streams_are_rejected(broken, test, monkeypatch):
    monkeypatch.setattr(random, "_threefry", broken)
    monkeypatch.setattr(random, "_normal_numbers", random._normal_numbers.__wrapped__)  # the sound stream is compiled already
    with engine.using("jax"):  # native kernels have a stream of their own, equal to the sound one
        assert test() < LEVEL


SHARDED = """
import hashlib, json
import jax, jax.numpy as jnp, numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from motes.core import random

assert len(jax.devices()) == 4
key = random.as_key(3)
found = []
for dtype in (jnp.float32, jnp.float64):
    for rows in (1, 5, 30):
        def draw(key):
            return random.normal(key, (rows, 4096), jnp.dtype(dtype)), random.uniform(key, (4096,), jnp.dtype(dtype))
        across = NamedSharding(Mesh(np.array(jax.devices()), ("p",)), PartitionSpec(None, "p"))
        along = NamedSharding(across.mesh, PartitionSpec("p"))
        spread = jax.jit(draw, out_shardings=(across, along))(key)
        assert len(spread[0].sharding.device_set) == 4
        found.append([hashlib.sha256(np.asarray(block).tobytes()).hexdigest() for block in spread])
print(json.dumps(found))
"""


@pytest.mark.night
def test_numbers_do_not_depend_on_sharding():
    environment = os.environ | {"XLA_FLAGS": "--xla_force_host_platform_device_count=4", "JAX_PLATFORMS": "cpu", "JAX_ENABLE_X64": "1"}
    done = subprocess.run([sys.executable, "-c", SHARDED], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    spread = json.loads(done.stdout)
    alone = subprocess.run([sys.executable, "-c", SHARDED.replace("== 4", ">= 1")], capture_output=True, text=True,
                           env=environment | {"XLA_FLAGS": ""})
    assert alone.returncode == 0, alone.stderr
    assert json.loads(alone.stdout) == spread
