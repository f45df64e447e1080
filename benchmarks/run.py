"""Times the filters on the cases that the documentation quotes and prints a table; run on an idle machine.

Each figure is the median over repeats of one compiled run divided by particles times steps.
"""

import statistics
import time

import jax
import jax.numpy as jnp
import numpy as np

import motes as mo

STEPS = 100


def radar_model(turning=False):
    """Range and azimuth of an aircraft, six states (paper 000, section IV, T = 0.5 s, a few hundred metres away).

    With `turning` the velocity is rotated by an angle that depends on the position: every matrix of the Kalman part then differs from
    particle to particle.
    """
    T = 0.5
    A = np.eye(6) + T * np.eye(6, k=2) + T * T / 2 * np.eye(6, k=4)
    Q, R = np.diag([1, 1, 1, 1, 0.01, 0.01]), np.diag([100, 1e-6])
    initial = mo.Gaussian([300.0, 300, 5, -5, 0, 0], np.diag([4.0, 4, 16, 16, 0.04, 0.04]))

    def sensor(x, u, t):
        return jnp.array([jnp.hypot(x[0], x[1]), jnp.arctan2(x[1], x[0])])

    def turn(x, u, t):
        angle = 0.01 * jnp.tanh(x[0] / 1000) + 0.02 * jnp.tanh(x[1] / 1000)
        rotation = jnp.array([[jnp.cos(angle), -jnp.sin(angle)], [jnp.sin(angle), jnp.cos(angle)]])
        return (jnp.asarray(A, x.dtype) @ x).at[2:4].set(rotation @ (x[2:4] + T * x[4:6]))

    dynamics = mo.AdditiveGaussian(turn, Q) if turning else mo.LinearGaussian(A, Q)
    return mo.StateSpaceModel(initial, dynamics, mo.AdditiveGaussian(sensor, R, angles=(1,)), ("px", "py", "vx", "vy", "ax", "ay"))


def nanoseconds(filter, model, ys, repeats=7):
    """Return nanoseconds per particle and step, and seconds to compile."""
    started = time.perf_counter()
    jax.block_until_ready(mo.run(0, filter, model, ys))
    first = time.perf_counter() - started
    times = []
    for seed in range(1, repeats + 1):
        started = time.perf_counter()
        jax.block_until_ready(mo.run(seed, filter, model, ys))
        times.append(time.perf_counter() - started)
    typical = statistics.median(times)
    return typical / (filter.n * len(ys)) * 1e9, first - typical


def main():
    radar, turning = radar_model(), radar_model(turning=True)
    ys = mo.simulate(0, radar, STEPS)[1]
    on = {"on_collapse": "predict"}
    cases = [
        *((f"bootstrap, radar, n = {n}", mo.ParticleFilter(n=n, policy=mo.Always(), **on), radar) for n in (2_000, 20_000, 200_000)),
        *(
            (f"marginalized, radar, shared Riccati, n = {n}", mo.MarginalizedParticleFilter(n=n, policy=mo.Always(), **on), radar)
            for n in (2_000, 20_000, 200_000)
        ),
        *(
            (f"marginalized, Riccati per particle (k = 4), n = {n}", mo.MarginalizedParticleFilter(n=n, policy=mo.Always(), **on), turning)
            for n in (2_000, 20_000)
        ),
    ]
    print(f"jax {jax.__version__}, {jax.devices()[0].device_kind}, {STEPS} steps, float32")
    print(f"{'case':<66}{'ns per particle and step':>26}{'compile s':>12}")
    for name, filter, model in cases:
        cost, compile_time = nanoseconds(filter, model, ys)
        print(f"{name:<66}{cost:>26.1f}{compile_time:>12.1f}", flush=True)


if __name__ == "__main__":
    main()
