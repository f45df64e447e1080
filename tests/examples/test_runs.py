"""Examples that run without data: small runs, against what was simulated."""

import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from examples_of import loaded


@pytest.fixture(scope="module")
def tanks():
    return loaded("tanks")


@pytest.fixture(scope="module")
def leak():
    return loaded("leak")


def test_parameters_of_tanks_go_to_the_kalman_part(tanks):
    found = mo.structure(tanks["tanks"](5.0, 0.003, 0.05), inputs=jnp.float32(0))
    assert found.linear == (2, 3, 4, 5, 6)


def test_tanks_are_identified(tanks, tmp_path):
    """Of what was simulated without noise of the levels, the noise of the measurements is left; level 1e-6."""
    recording = tanks["made_up"](400)
    true = tanks["foretold"](np.array([0.24, 0.14, 0.14, 0.2, 0.9]), recording)
    assert abs(np.std(true - recording.y_test) - 0.05) < 4.9 * 0.05 / 800**0.5
    history = tanks["passed"](mo.MarginalizedParticleFilter(n=1_000), tanks["tanks"](recording.y[0], 0.0, 0.05), recording, 2)
    assert all(tanks["rmse"](mean, recording) < 0.4 for mean in np.asarray(history.mean)[:, -1, 2:])
    k = tanks["fitted"](recording)
    assert tanks["rmse"](k, recording) < 0.1
    tanks["picture"](recording, history, k).savefig(tmp_path / "tanks.png")


@pytest.mark.night
def test_all_ways_are_in_the_table(tanks):
    table, _, history = tanks["compared"](tanks["made_up"](400), 200, 2)
    assert len({row[:3] for row in table.rows}) == 13 and history.mean.shape == (2, 400, 7)
    assert np.isfinite([row[3] for row in table.rows]).all()


def test_large_leaks_are_found(leak):
    """A leak of 30 percent from step 40 on, against what is said of the steps before it."""
    runs = 4
    worlds = [leak["tanks"](), leak["tanks"](upper=0.3, since=40), leak["tanks"](lower=0.3, since=40)]
    ys = jnp.concatenate([leak["simulated"](seed, truth, runs, 80) for seed, truth in enumerate(worlds)])
    found = leak["watched"](ys, 5)
    for name, said in found.items():
        assert said.any.shape == (12, 80) and (said.any[4:, -1] > said.any[4:, :40].max(axis=1)).all(), name
        assert (said.any[4:, -1] > said.any[:4].max()).all(), name


def test_delays_are_counted_from_the_leak(leak):
    statistic = np.zeros((4, 800))
    statistic[0, 310:], statistic[1, 100], statistic[2, 330:] = 1, 1, 1
    said = leak["Statistics"](statistic, np.stack([statistic, 2 * statistic]))
    assert leak["judged"](said, 0.5, 1) == (30.0, 1 / 3, 1.0)
