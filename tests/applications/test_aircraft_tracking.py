"""An airliner tracked by radar plots drawn from its recorded flight: smoother, model, and the trackers side by side over 20 seeds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from data import recorded
from motes.applications.aircraft_tracking import scenario
from motes.applications.aircraft_tracking.model import Flight, Radar, constant_velocity, jumping, turned, white_acceleration

SEEDS, STEPS = 20, 1660


def test_the_smoother_gives_the_moments_of_one_large_gaussian():
    """Positions and speeds of a random walk in acceleration, as one linear system solved at once; no residual is an outlier."""
    rng = np.random.default_rng(0)
    times = np.cumsum(np.r_[0.0, rng.integers(1, 4, 11)])
    position, speed = 100 * times + rng.normal(0, 30, 12), 100 + rng.normal(0, 2, 12)
    rows, values = [], []

    def equation(weights, at, value, root):
        row = np.zeros((len(root), 36))
        for (i, block) in zip(at, weights, strict=True):
            row[:, 3 * i : 3 * i + 3] = block
        rows.append(np.linalg.solve(root, row)), values.append(np.linalg.solve(root, value))

    equation([np.eye(3)], [0], np.array([position[0], speed[0], 0]), np.diag([50.0, 2.0, 1.0]))
    for i in range(12):
        equation([np.eye(3)[:2]], [i], np.array([position[i], speed[i]]), np.diag([50.0, 2.0]))
        if i:
            dt = times[i] - times[i - 1]
            F = np.array([[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]])
            inner = [[dt**5 / 20, dt**4 / 8, dt**3 / 6], [dt**4 / 8, dt**3 / 3, dt**2 / 2], [dt**3 / 6, dt**2 / 2, dt]]
            equation([np.eye(3), -F], [i, i - 1], np.zeros(3), np.linalg.cholesky(inner))
    wanted = np.linalg.lstsq(np.concatenate(rows), np.concatenate(values), rcond=None)[0].reshape(12, 3)
    assert np.allclose(scenario.smoothed(times, position, speed), wanted, rtol=1e-6, atol=1e-6)
    late = position.copy()
    late[6] -= 3000.0
    assert np.abs(scenario.smoothed(times, late, speed) - wanted)[:, 0].max() < 150


def test_a_coordinated_turn_is_a_circle(double):
    x = jnp.array([100.0, -50.0, 80.0, 60.0, 0.03])
    steps = np.asarray(turned(x, jnp.asarray(7.0)))
    half = jnp.append(turned(x, jnp.asarray(3.5)), 0.03)
    assert np.allclose(turned(half, jnp.asarray(3.5)), steps, rtol=1e-12)
    center = np.array([100.0 - 60.0 / 0.03, -50.0 + 80.0 / 0.03])
    assert np.allclose(np.hypot(*(steps[:2] - center)), 100 / 0.03, rtol=1e-12)
    for rate in (0.0, 1e-9, 1.4e-4, 1.5e-4):
        straight = x.at[4].set(rate)
        slope = jax.jacfwd(lambda x: turned(x, jnp.asarray(7.0)))(straight)
        assert np.isfinite(slope).all() and np.allclose(slope[:2, 4], [-49 / 2 * 60, 49 / 2 * 80], rtol=1e-2)
    assert np.allclose(white_acceleration(2.0, 3.0)[1], [0, 18, 0, 9])


@pytest.fixture(scope="module")
def flights():
    path = scenario.read_path(recorded("aircraft/adsb/belevingsvlucht.csv"))
    tracks = [scenario.track(path, seed, STEPS, Radar()) for seed in range(SEEDS)]
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *tracks)


def flown(filter, build, flights):
    """Scores and numbers of collapses over all seeds."""

    def one(key, track):
        history = mo.run(key, filter, build(track.start), track.ys, track.dt, keep=mo.keep.means)
        return scenario.score(history.mean, track), jnp.sum(history.info.collapsed)

    keys = jax.random.split(jax.random.key(0), SEEDS)
    return jax.tree.map(np.asarray, jax.jit(jax.vmap(one))(keys, flights))


@pytest.mark.optimized  # much to compute
def test_particles_with_modes_beat_constant_velocity_and_equal_interacting_models(flights):
    """Mean position at most 43 m and velocity at most 8.2 m/s with 200 particles, no track lost, in 20 seeds."""
    assert np.all(np.asarray(flights.scored).sum(axis=1) > 1350)
    jump, _ = flown(mo.JumpMarkovFilter(n=200, sampled=("turn",)), lambda start: jumping(start, Flight(), Radar()), flights)
    mixed, _ = flown(mo.InteractingMultipleModel(), lambda start: jumping(start, Flight(), Radar()), flights)
    assert jump.position.mean() < 43 and jump.velocity.mean() < 8.2 and jump.worst.max() < scenario.LOST
    assert jump.position.mean() < mixed.position.mean() + 0.5 and jump.velocity.mean() < mixed.velocity.mean() + 0.1
    for intensity in (10.0, 30.0):
        plain, _ = flown(mo.ExtendedKalmanFilter(), lambda start, q=intensity: constant_velocity(start, q, Radar()), flights)
        assert np.all(jump.position < plain.position) and np.all(jump.velocity < plain.velocity)


def test_a_particle_filter_of_constant_velocity_is_lost_and_says_so(flights):
    """With q = 5 m^2/s^3 the first turn loses it in every seed, and from then on no particle explains the plots."""
    few = jax.tree.map(lambda leaf: leaf[:3], flights)
    filter = mo.ParticleFilter(n=1000, on_collapse="predict")

    def one(key, track):
        history = mo.run(key, filter, constant_velocity(track.start, 5.0, Radar()), track.ys, track.dt, keep=mo.keep.means)
        return scenario.score(history.mean, track), history.info.collapsed

    lost, collapsed = jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(0), 3), few)
    assert np.all(np.asarray(lost.worst) > scenario.LOST) and np.all(np.asarray(collapsed).sum(axis=1) > 100)
