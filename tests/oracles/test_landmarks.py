"""Maps of landmarks against the exact answer: a linear system among landmarks of two places each, one Kalman filter for every choice."""

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from data import refused
from motes.laws.sightings import NONE
from tiers import each

pytestmark = pytest.mark.jax
STEPS, LANDMARKS, RUNS, LEVEL = 12, 3, 64, 1e-6
Q, R, BIAS = np.diag([0.09, 0.04]), np.array([[0.25, 0.05], [0.05, 0.16]]), 0.5
SHIFT, SHARES = np.array([2.0, -1.0]), np.array([0.65, 0.35])
"""At its first sighting a landmark is where it was seen, or beside it."""
OFF = 4.753424
"""Standard deviations that chance exceeds once in 5e5: LEVEL on both sides."""


def here(array):
    """The same array anew: JAX takes one that it has seen in double precision for one of such numbers."""
    return jnp.asarray(array.tolist())


def system(linear=(), **changes):
    """px and py go on by a bias that nobody knows; sightings are differences."""
    dynamics = mo.LinearGaussian(np.array([[1.0, 0, 1], [0, 1, 0], [0, 0, 1]]), np.diag([*np.diag(Q), 0.0]))
    initial = mo.Gaussian([0.0, 0.0, 0.2], np.diag([1e-3, 1e-3, BIAS**2]))

    def birth(x, z):
        means = jnp.stack([x[:2] + z, x[:2] + z + here(SHIFT)], axis=1)
        return mo.Mixture(mo.Gaussian(means, jnp.stack([here(R), 2.0 * here(R)], axis=2)), jnp.log(here(SHARES)))

    given = {"birth": birth, "landmarks": LANDMARKS, "linear": linear, "names": ("px", "py", "bias")} | changes
    return mo.MapModel(initial, dynamics, lambda x, place, u, t: place - x[:2], here(R), **given)


@pytest.fixture(scope="module")
def recorded():
    """Sightings of a way, and where nothing is seen."""
    rng = np.random.default_rng(3)
    x, b, places = np.zeros(2), 0.6, np.array([[1.0, 2.0], [4.0, -1.5], [8.0, 1.0]])
    steps = []
    for t in range(STEPS):
        x = x + np.array([b, 0]) * (t > 0) + rng.multivariate_normal([0, 0], Q) * (t > 0)
        seen = [k for k in range(LANDMARKS) if t != 5 and rng.random() < 0.7]
        steps.append([(k, places[k] - x + rng.multivariate_normal([0, 0], R)) for k in seen])
    assert {k for step in steps for k, _ in step} == {0, 1, 2}
    return steps


def exact(steps):
    """Log evidence, mean of (px, py, bias) and of the landmarks, by a Kalman filter for each choice of places."""
    F = np.array([[1.0, 0, 1], [0, 1, 0], [0, 0, 1]])
    found = []
    for choice in product((0, 1), repeat=LANDMARKS):
        m, P = np.array([0.0, 0.0, 0.2]), np.diag([1e-3, 1e-3, BIAS**2])
        where, log_evidence = {}, float(np.log(SHARES[list(choice)]).sum())
        for t, step in enumerate(steps):
            if t:
                whole = np.eye(len(m))
                whole[:3, :3] = F
                m, P = whole @ m, whole @ P @ whole.T
                P[:2, :2] += Q
            for k, z in step:
                H = np.zeros((2, len(m)))
                H[:, :2] = -np.eye(2)
                if k not in where:
                    where[k] = len(m)
                    new = m[:2] + z + choice[k] * SHIFT
                    across = P[:2]
                    m = np.concatenate([m, new])
                    P = np.block([[P, across.T], [across, P[:2, :2] + (1 + choice[k]) * R]])
                    continue
                H[:, where[k] : where[k] + 2] = np.eye(2)
                S, off = H @ P @ H.T + R, z - H @ m
                log_evidence -= 0.5 * (off @ np.linalg.solve(S, off) + np.linalg.slogdet(2 * np.pi * S)[1])
                K = P @ H.T @ np.linalg.inv(S)
                m, P = m + K @ off, P - K @ S @ K.T
        places = np.stack([m[where[k] : where[k] + 2] for k in range(LANDMARKS)])
        found.append((log_evidence, m[:3], places))
    logs = np.array([one[0] for one in found])
    weights = np.exp(logs - np.logaddexp.reduce(logs))
    means, places = (np.array([one[part] for one in found]) for part in (1, 2))
    return np.logaddexp.reduce(logs), weights @ means, np.tensordot(weights, places, 1)


FILTERS = {
    "with the sightings": mo.LandmarkFilter(n=100, on_collapse="predict"),
    "blind": mo.LandmarkFilter(n=400, proposal=False, on_collapse="predict"),
}


@pytest.mark.parametrize("linear", [(), ("bias",)], ids=["sampled", "marginalized"])
@pytest.mark.parametrize("name", each(list(FILTERS), {"blind"}))
def test_equals_one_kalman_filter_for_each_choice_of_places(name, linear, recorded, double):
    model, ys = system(linear), mo.sightings(recorded)
    log_evidence, mean, places = exact(recorded)

    def one(key):
        history = mo.run(key, FILTERS[name], model, ys)
        return history.log_likelihood, history.mean[-1], history.state.landmarks().mean

    found, means, maps = (np.asarray(part) for part in jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(4), RUNS)))
    ratio = np.exp(found - log_evidence)
    assert abs(ratio.mean() - 1) < OFF * ratio.std() / np.sqrt(RUNS), ratio.mean()
    assert ratio.std() / np.sqrt(RUNS) < 0.12
    # averages of posterior means weighed by the evidence are those of one filter with all particles
    weights = ratio / ratio.sum()
    for values, wanted in ((means, mean), (maps.reshape(RUNS, -1), places.ravel())):
        error = weights @ values - wanted
        spread = np.sqrt(np.sum(weights[:, None] ** 2 * (values - weights @ values) ** 2, axis=0))
        assert np.all(np.abs(error) < OFF * spread + 1e-9), (error, spread)
        assert spread.max() < 0.12


def test_sightings_that_nobody_numbered_are_of_the_nearest(recorded):
    far = [[(k, z + 30 * np.array([k == 1, k == 2])) for k, z in step] for step in recorded]
    model = system(birth=lambda x, z: mo.Gaussian(x[:2] + z, here(R)), limit=40.0)
    named = mo.sightings(far)
    unnamed = np.asarray(named.value["z"])
    filter = mo.LandmarkFilter(n=200)
    one, other = mo.run(1, filter, model, named), mo.run(1, filter, model, unnamed)
    order = list(dict.fromkeys(k for step in far for k, _ in step))
    np.testing.assert_allclose(one.mean, other.mean, atol=1e-4)
    np.testing.assert_allclose(np.asarray(one.state.landmarks().mean)[order], other.state.landmarks().mean, atol=1e-4)
    # each of the three was new once for every particle
    assert float(one.log_likelihood) > float(other.log_likelihood)


@pytest.mark.night
def test_more_landmarks_than_there_is_room_for_are_left_out(recorded):
    model = system(birth=lambda x, z: mo.Gaussian(x[:2] + z, here(R)), limit=40.0, landmarks=2, outliers=(0.01, 0.001))
    far = [[(k, z + 30 * np.array([k == 1, k == 2])) for k, z in step] for step in recorded]
    history = mo.run(1, mo.LandmarkFilter(n=100), model, np.asarray(mo.sightings(far).value["z"]))
    assert np.isfinite(np.asarray(history.mean)).all() and not np.asarray(history.info.collapsed).any()


@pytest.mark.parametrize("proposal", [True, False])
def test_a_sighting_of_something_else_moves_nothing(proposal, recorded):
    wild = [[*step, (1, np.array([400.0, -300.0]))] if t == 9 else step for t, step in enumerate(recorded)]
    model, filter = system(outliers=(0.01, 1e-4)), mo.LandmarkFilter(n=300, proposal=proposal)
    usual, other = (mo.run(2, filter, model, mo.sightings(steps)) for steps in (recorded, wild))
    np.testing.assert_allclose(usual.mean[9], other.mean[9], atol=1e-3)
    np.testing.assert_allclose(usual.state.landmarks().mean, other.state.landmarks().mean, atol=0.02)
    assert float(usual.info.log_evidence[9] - other.info.log_evidence[9]) == pytest.approx(-np.log(0.01 * 1e-4), rel=1e-3)


def test_known_places_are_found_and_paths_followed(recorded):
    model = system(("bias",))
    xs, ys = mo.simulate(5, model.among([[1.0, 2.0], [4.0, -1.5], [8.0, 1.0]]), 40)
    located = mo.run(6, mo.ParticleFilter(n=2_000), model.among([[1.0, 2.0], [4.0, -1.5], [8.0, 1.0]]), ys)
    assert np.sqrt(np.mean((located.mean[10:, :2] - xs[10:, :2]) ** 2)) < 0.5
    history = mo.run(7, mo.LandmarkFilter(n=200), model, ys, keep=mo.keep.paths)
    smoothed = mo.smooth(8, mo.smoothers.GenealogySmoother(), model, history)
    np.testing.assert_allclose(smoothed.mean[-1], history.mean[-1], atol=1e-5)
    off = [np.sqrt(np.mean((one.mean[:, :2] - xs[:, :2]) ** 2)) for one in (history, smoothed)]
    assert off[1] < off[0] < 1.0, off


@pytest.mark.night
def test_an_empty_map_and_steps_without_sightings(recorded):
    model = system(("bias",))
    for filter in FILTERS.values():
        history = mo.run(1, filter, model, mo.sightings([[], *recorded[:1], None]))
        np.testing.assert_allclose(history.mean[0], [0, 0, 0.2], atol=0.12)
        state = mo.run(1, filter, model, mo.sightings([[], [(0, [1.0, 2.0])], []])).state.landmarks()
        assert np.isfinite(state.mean[0]).all() and np.isnan(state.mean[1:]).all() and state.seen.tolist() == pytest.approx([1, 0, 0])
        assert float(history.info.log_evidence[0]) == 0


BAD = [
    (lambda: system(landmarks=0), "MapModel landmarks"), (lambda: system(linear=("py", "x")), "state: expected one of the names"),
    (lambda: system(outliers=(1.5, 1.0)), "MapModel outliers share"), (lambda: system(limit=0.0), "MapModel limit"),
    (lambda: system(birth=3), "MapModel birth"), (lambda: mo.LandmarkFilter(n=0), "LandmarkFilter n"),
    (lambda: mo.LandmarkFilter(n=9, proposal=1), "LandmarkFilter proposal"),
    (lambda: mo.sightings([[(-1, [1.0])]]), "sightings step 0"),
    (lambda: mo.sightings([[(0, [1.0])], [(0, [1.0, 2.0])]]), "sightings: expected"),
    (lambda: mo.sightings([[], None]), "sightings: expected"),
    (lambda: mo.run(0, mo.LandmarkFilter(n=9), system(linear=("px",)), mo.sightings([[(0, [1.0, 2.0])]])), "MapModel linear: expected"),
    (lambda: mo.run(0, mo.LandmarkFilter(n=9), mo.textbook.growth(), np.ones((2, 1))), "LandmarkFilter model: expected a MapModel"),
    (lambda: mo.run(0, mo.ParticleFilter(n=9), system(), mo.sightings([[(0, [1.0, 2.0])]])), "model.among(places)"),
    (lambda: mo.run(0, mo.LandmarkFilter(n=9), system(), np.ones((4, 2))), "ys: expected sightings"),
    (lambda: mo.run(0, mo.LandmarkFilter(n=9), system(), mo.sightings([[(0, [1.0, 2.0, 3.0])]])), "2 components"),
    (lambda: mo.run(0, mo.LandmarkFilter(n=9), system(), mo.sightings([[(7, [1.0, 2.0])]])), "ys landmark: expected numbers of the 3"),
    (lambda: mo.run(0, mo.LandmarkFilter(n=9), system(birth=lambda x, z: x), mo.sightings([[(0, [1.0, 2.0])]])), "birth(x, z)"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "said"), BAD, ids=[said for _, said in BAD])
def test_bad_input_is_told_in_one_line(call, said):
    with pytest.raises(mo.MotesError) as error:
        call()
    refused(error, said)


def test_sightings_are_padded():
    found = mo.sightings([{2: [1.0, 2.0]}, [(0, [3.0, 4.0]), (0, [5.0, 6.0])], None])
    assert found.value["landmark"].tolist() == [[2, NONE], [0, 0], [NONE, NONE]] and found.there.tolist() == [True, True, False]
    assert found.value["z"].shape == (3, 2, 2) and np.isnan(found.value["z"][2]).all()
