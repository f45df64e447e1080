"""Motes itself: as it comes or on one engine, keeping nothing of each step but evidence and ESS, or mean and covariance too."""

import jax
import jax.numpy as jnp
import numpy as np
from problems import INTERVAL, LINE, PENDULUMS, RADAR, TRACK, looked_up, substepped, swing

import motes as mo
from peers import Unavailable, offers


def line_model():
    """Give the 1-D linear Gaussian model."""
    initial = mo.Gaussian([LINE["mean"]], [[LINE["variance"]]])
    sensor = mo.LinearGaussian([[1.0]], [[LINE["r"]]])
    return mo.StateSpaceModel(initial, mo.LinearGaussian([[LINE["a"]]], [[LINE["q"]]]), sensor)


def track_model():
    """Give the linear model of the Kalman filters."""
    initial = mo.Gaussian(TRACK["mean"], np.diag(TRACK["P"]))
    sensor = mo.LinearGaussian(TRACK["H"], np.diag(TRACK["R"]))
    return mo.StateSpaceModel(initial, mo.LinearGaussian(TRACK["A"], np.diag(TRACK["Q"])), sensor)


def pendulum_model():
    """Give the pendulums, with substeps in a loop and a table that every particle looks up at its own place."""
    table = jnp.asarray(PENDULUMS["table"], jnp.float32)

    def slope(x):
        return jnp.array([x[2], x[3], *swing(x[:2], x[2:], jnp.sin, jnp.cos)])

    def move(x, u, t):
        return jax.lax.fori_loop(0, PENDULUMS["substeps"], lambda i, x: substepped(x, slope), x)

    def sensor(x, u, t):
        return jnp.array([looked_up(x, table, jnp.int32)])

    dynamics = mo.AdditiveGaussian(move, np.diag(PENDULUMS["Q"]))
    initial = mo.Gaussian(PENDULUMS["mean"], np.diag(PENDULUMS["P"]))
    return mo.StateSpaceModel(initial, dynamics, mo.AdditiveGaussian(sensor, np.diag(PENDULUMS["R"])))


def radar_model(turning=False):
    """Give the radar model; with `turning` every matrix of its Kalman part differs from particle to particle."""

    def sensor(x, u, t):
        return jnp.array([jnp.hypot(x[0], x[1]), jnp.arctan2(x[1], x[0])])

    def turn(x, u, t):
        angle = 0.01 * jnp.tanh(x[0] / 1000) + 0.02 * jnp.tanh(x[1] / 1000)
        rotation = jnp.array([[jnp.cos(angle), -jnp.sin(angle)], [jnp.sin(angle), jnp.cos(angle)]])
        return (jnp.asarray(RADAR["A"], x.dtype) @ x).at[2:4].set(rotation @ (x[2:4] + INTERVAL * x[4:6]))

    initial, Q = mo.Gaussian(RADAR["mean"], np.diag(RADAR["P"])), np.diag(RADAR["Q"])
    dynamics = mo.AdditiveGaussian(turn, Q) if turning else mo.LinearGaussian(RADAR["A"], Q)
    names = ("px", "py", "vx", "vy", "ax", "ay")
    return mo.StateSpaceModel(initial, dynamics, mo.AdditiveGaussian(sensor, np.diag(RADAR["R"]), angles=(1,)), names)


MODELS = {
    "line": line_model, "track": track_model, "radar": radar_model, "turning": lambda: radar_model(turning=True),
    "circling": radar_model, "pendulums": pendulum_model,
}  # fmt: skip


def flight(task):
    """Give filter, model, measurements and inputs of the terrain demo."""
    from motes.applications.terrain.job import load
    from motes.applications.terrain.settings import Inertial, Settings

    job = load(Settings(inertial=Inertial(states=task["states"])), 0)
    of = {"marginalized": mo.MarginalizedParticleFilter, "kernel": mo.KalmanParticleKernelFilter}[task["filter"]]
    return of(n=task["n"], on_collapse="predict"), job.model, job.ys, job.inputs


def prepare(task, engine="jax", keep="nothing"):
    """Prepare a run; the model is built anew, from fresh functions. A run that another engine took over is refused."""
    offers(task, ("bootstrap", "many", "marginalized", "kalman", "terrain"))
    kind, often = task["kind"], {"policy": mo.resampling.Always(), "on_collapse": "predict"}
    inputs, keep = None, getattr(mo.keep, keep)
    if kind == "terrain":
        filter, model, ys, inputs = flight(task)
    else:
        model, ys = MODELS[task["model"]](), np.asarray(task["ys"], jnp.result_type(float))
    if kind == "kalman":
        filter = mo.KalmanFilter()
    elif kind == "marginalized":
        filter = mo.MarginalizedParticleFilter(n=task["n"], **often)
    elif kind != "terrain":
        filter = mo.ParticleFilter(n=task["n"], **often)

    def log_likelihood(key):
        history = mo.run(key, filter, model, ys, inputs, keep=keep)
        if engine != "auto" and engine not in history.engine:
            raise Unavailable(f"ran as {history.engine}")
        return history.log_likelihood

    every = jax.jit(jax.vmap(log_likelihood))

    def job(seed):
        with mo.engine(engine):
            if kind == "many":
                return float(jnp.mean(every(jax.random.split(jax.random.key(seed), task["runs"]))))
            return float(log_likelihood(seed))

    return job
