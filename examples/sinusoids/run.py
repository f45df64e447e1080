"""How many sinusoids are there in noise? Model selection as in signal processing (Andrieu, Doucet 1999).

    python examples/sinusoids/run.py [--draws 2000]

64 samples of three sinusoids, two of them closer than the resolution 2 pi / 64, at a signal-to-noise ratio of some 3 dB each. Amplitudes
have a g-prior with g = 64 and are integrated out, as is the variance of the noise; frequencies are uniform on (0, pi), their number is
uniform on 0 to 6. The picture goes to out/sinusoids.png. It takes less than a minute.
"""

import argparse
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import motes as mo
from motes.plotting.figures import DASHED, ESTIMATE, TRUE, legend_below, new_figure, tidy

MOST, SAMPLES, G = 6, 64, 64.0
WAVES = ((0.63, 1.4, 0.3), (0.72, 1.4, 1.2), (1.9, 1.0, 0.0))
"""Frequency, amplitude and phase of each."""


def signal(seed=4):
    """Draw the noisy samples."""
    times = np.arange(SAMPLES)
    clean = sum(a * np.cos(w * times + phase) for w, a, phase in WAVES)
    return clean + 0.7 * np.random.default_rng(seed).normal(size=SAMPLES)


def periodogram(y):
    """Return frequencies between 0 and pi and the power of samples there."""
    power = np.abs(np.fft.rfft(np.asarray(y), 512))[1:-1] ** 2
    return np.pi * (1 + np.arange(power.size)) / (power.size + 1), power


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
    peaks, power = periodogram(y)
    top = np.argsort(power)[::-1][:40]
    births = mo.Mixture.of(jnp.asarray(np.append(power[top] / power[top].sum(), 0.5)), jnp.asarray(np.append(peaks[top], np.pi / 2))[None],
                           jnp.asarray(np.append(np.full(40, 0.02**2), 1.5**2))[None, None])  # fmt: skip
    jumps = mo.mcmc.birth_death(births, MOST)
    walk = mo.mcmc.Mix([mo.mcmc.RandomWalkMetropolis(0.004), mo.mcmc.RandomWalkMetropolis(0.03)])
    return log_density, mo.mcmc.ReversibleJump(jumps, lambda k: k, within=walk), mo.mcmc.Configuration(jnp.int32(0), jnp.zeros(MOST))


def picture(y, counts, frequencies):
    """Draw the periodogram, and how many sinusoids the draws expect in each 0.02 rad: counts `(draw,)`, frequencies `(draw, MOST)`."""
    figure = new_figure(8, 4.5)
    above, below = (figure.add_subplot(2, 1, place) for place in (1, 2))
    above.plot(*periodogram(y), color=TRUE, linewidth=1, label="periodogram")
    above.set(ylabel="power", ylim=(0, None))
    drawn = frequencies[np.arange(MOST) < counts[:, None]]
    below.hist(drawn, bins=np.arange(0, np.pi + 0.02, 0.02), weights=np.full(drawn.size, 1 / counts.size), color=ESTIMATE, label="draws")
    below.set(xlabel="frequency, rad a sample", ylabel="expected number")
    for axes in (above, below):
        tidy(axes)
        axes.set_xlim(0, np.pi)
        for place, (w, _, _) in enumerate(WAVES):
            axes.axvline(w, **DASHED, label=None if place or axes is above else "true")
    legend_below(figure, below, 2)
    return figure


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
    print("true: " + ", ".join(f"{w:.3f}" for w, _, _ in WAVES))
    for name, rate in chains.acceptance.items():
        print(f"{name}: {rate:.1%} accepted")
    Path("out").mkdir(exist_ok=True)
    picture(signal(), counts.ravel(), np.asarray(chains.positions.x).reshape(-1, MOST)).savefig("out/sinusoids.png")
    print("picture: out/sinusoids.png")


if __name__ == "__main__":
    main()
