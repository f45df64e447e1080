"""What a user with NumPy arrays and a strict type checker writes: `make lint` checks it by the settings beside it, nobody runs it."""

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

import motes as mo


def move(x: jax.Array, u: None, t: jax.Array) -> jax.Array:
    return x + 0.1 * jnp.sin(x)


def see(x: jax.Array, u: None, t: jax.Array) -> jax.Array:
    return x[:1] ** 2


def measured(steps: int) -> npt.NDArray[np.float64]:
    rng = np.random.default_rng(0)
    return rng.normal(size=(steps, 1))


initial = mo.Gaussian([0.0, 0.0], np.eye(2))
still, first = mo.LinearGaussian(np.eye(2), 0.1 * np.eye(2)), mo.LinearGaussian(np.array([[1.0, 0.0]]), [[1.0]])
linear = mo.StateSpaceModel(initial, still, first, ("a", "b"))
curved = mo.StateSpaceModel(initial, mo.AdditiveGaussian(move, 0.1 * np.eye(2)), mo.AdditiveGaussian(see, np.eye(1)))
ys = measured(50)

exact = mo.run(0, mo.KalmanFilter(), linear, ys)
cloud = mo.run(jax.random.key(1), mo.ParticleFilter(n=500), curved, ys.tolist(), keep=mo.keep.laws)
mean: npt.NDArray[np.float32] = np.asarray(exact.mean)
likelihood = float(exact.log_likelihood)
smoothed = mo.smooth(2, mo.smoothers.RauchTungStriebelSmoother(), linear, exact, ys)
spread = float(smoothed.cov[0, 0, 0])

forecast = mo.forecast(exact, 12)
lower, upper = forecast.interval(0.9)
width: jax.Array = upper - lower

stream = mo.stream(3, mo.ParticleFilter(n=100), curved)
for y in ys[:3]:
    stream.update(y)
    stream.predict()
figure = mo.plot(exact, truth=np.zeros((50, 2)), states=("a", "b"))
width_of_picture = float(figure.get_figwidth())
exact.save("run.npz")
again = mo.History.load("run.npz")
print(again, mo.diagnose(again).trusted, exact.to_xarray().sizes, spread, likelihood, mean.shape, width.shape)
particles: jax.Array = cloud.state.particles
weights: jax.Array = stream.state.log_weights
covariance: jax.Array = exact.law.cov()
print(particles.shape, weights.shape, covariance.shape)
