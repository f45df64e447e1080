"""How many sinusoids are there in noise? Model selection as in signal processing (Andrieu, Doucet 1999).

    python examples/sinusoids/run.py [--draws 2000]

64 samples of three sinusoids, two of them closer than the resolution 2 pi / 64, at a signal-to-noise ratio of some 3 dB each. Amplitudes
have a g-prior with g = 64 and are integrated out, as is the variance of the noise; frequencies are uniform on (0, pi), their number is
uniform on 0 to 6. It takes less than a minute.
"""

import argparse

import jax.numpy as jnp
import numpy as np

import motes as mo

MOST, SAMPLES, G = 6, 64, 64.0
TRUE = ((0.63, 1.4, 0.3), (0.72, 1.4, 1.2), (1.9, 1.0, 0.0))
"""Frequency, amplitude and phase of each."""


def signal(seed=4):
    """Draw the noisy samples."""
    times = np.arange(SAMPLES)
    clean = sum(a * np.cos(w * times + phase) for w, a, phase in TRUE)
    return clean + 0.7 * np.random.default_rng(seed).normal(size=SAMPLES)


def problem(y):
    """Return log density, kernel and start for samples y."""
    y, times = jnp.asarray(y, jnp.float32), jnp.arange(len(y))
    energy = jnp.sum(y**2)

    def log_density(c):
        live = jnp.arange(MOST) < c.model
        w = c.x
        waves = [wave(times[:, None] * w) for wave in (jnp.cos, jnp.sin)]
        basis = jnp.concatenate([jnp.where(live, wave, 0) for wave in waves], axis=1)
        # dead columns get a unit diagonal, so that they change nothing
        dead = 1 - jnp.tile(live, 2)
        gram = basis.T @ basis + jnp.diag(dead + 1e-3)
        explained = (basis.T @ y) @ jnp.linalg.solve(gram, basis.T @ y)
        rest = energy - G / (1 + G) * explained
        inside = jnp.all(~live | ((w > 0) & (w < jnp.pi)))
        # frequencies in a list: their density is uniform for each
        return jnp.where(inside, -c.model * jnp.log(1 + G) - len(y) / 2 * jnp.log(rest) - c.model * jnp.log(jnp.pi), -jnp.inf)

    # births where the periodogram is high, and anywhere
    power = np.abs(np.fft.rfft(np.asarray(y), 512))[1:-1] ** 2
    peaks = np.pi * (1 + np.arange(power.size)) / (power.size + 1)
    top = np.argsort(power)[::-1][:40]
    births = mo.Mixture.of(jnp.asarray(np.append(power[top] / power[top].sum(), 0.5)), jnp.asarray(np.append(peaks[top], np.pi / 2))[None],
                           jnp.asarray(np.append(np.full(40, 0.02**2), 1.5**2))[None, None])  # fmt: skip
    jumps = mo.mcmc.birth_death(births, MOST)
    walk = mo.mcmc.Mix([mo.mcmc.RandomWalkMetropolis(0.004), mo.mcmc.RandomWalkMetropolis(0.03)])
    return log_density, mo.mcmc.ReversibleJump(jumps, lambda k: k, within=walk), mo.mcmc.Configuration(jnp.int32(0), jnp.zeros(MOST))


def main():
    """Draw the posterior of the number of sinusoids."""
    parser = argparse.ArgumentParser(description="Number of sinusoids in noise.")
    parser.add_argument("--draws", type=int, default=2000, help="draws of each of eight chains (2000)")
    given = parser.parse_args()
    log_density, kernel, start = problem(signal())
    chains = mo.sample(0, mo.mcmc.Repeat(kernel, 10), log_density, start, draws=given.draws, chains=8)
    counts = np.asarray(chains.positions.model)
    print(mo.mcmc.frequencies(counts))
    likely = np.bincount(counts.ravel()).argmax()
    found = np.sort(np.asarray(chains.positions.x)[counts == likely][:, :likely], axis=1)
    told = (f"{mean:.3f} +- {sd:.3f}" for mean, sd in zip(found.mean(axis=0), found.std(axis=0), strict=True))
    print(f"frequencies given {likely}: {', '.join(told)}")
    print("true: " + ", ".join(f"{w:.3f}" for w, _, _ in TRUE))
    for name, rate in chains.acceptance.items():
        print(f"{name}: {rate:.1%} accepted")


if __name__ == "__main__":
    main()
