"""Detectors of eight users side by side: what is wrong on the same words, counted and drawn."""

from typing import Any, NamedTuple

import cdma
import jax
import numpy as np
from rates import SIGMAS, Compared, over

from motes.plotting.figures import TRUE, legend_below, new_figure, tidy

EXACT, PLAIN, TEMPERED = "exact, each bit", "Gibbs", "Gibbs, tempered"
KERNELS = {PLAIN: cdma.PLAIN, TEMPERED: cdma.TEMPERED}


def means_and_words(seed: int, decibels: float, words: int) -> tuple[jax.Array, cdma.Received, dict[str, np.ndarray], jax.Array]:
    """Draw words; return their bits, what is received, means of each bit by enumeration and by both chains, and the most probable word."""
    keys = jax.random.split(jax.random.key(seed))
    bits, given = cdma.sent(keys[0], decibels, words)
    word, mean = cdma.enumerated(given)
    means = {EXACT: mean, **{name: cdma.sampled(keys[1], given, kernel).value for name, kernel in KERNELS.items()}}
    return bits, given, {name: np.asarray(each) for name, each in means.items()}, word


class Decided(NamedTuple):
    """What detectors decide on the same words, by detector.

    Attributes:
        wrong: which bits are, `(words, users)`.
        chance: with which probability each is, given what was received, as enumeration knows it: two detectors that nearly agree are
            compared by it on far fewer words than by counting.
    """

    wrong: dict[str, np.ndarray]
    chance: dict[str, np.ndarray]


def decided(seed: int, decibels: float, words: int) -> Decided:
    """Let all detectors decide."""
    bits, given, means, word = means_and_words(seed, decibels, words)
    linear = {"matched filter": given.filtered, "decorrelator": cdma.decorrelated(given), "MMSE": cdma.least_squares(given)}
    # a bit that is as likely to be either is guessed
    guess = np.random.default_rng(seed).uniform(-1e-6, 1e-6, bits.shape)
    said = {name: np.sign(np.asarray(each) + guess) for name, each in {**linear, "exact, whole word": word, **means}.items()}
    chance = {name: 0.5 * (1 - each * means[EXACT].astype(float)) for name, each in said.items()}
    return Decided({name: each != np.asarray(bits) for name, each in said.items()}, chance)


def compared(decibels: tuple[float, ...], words: int) -> Compared:
    """Compare the detectors, on fewer words where errors are many."""
    many = {each: max(100, int(words * min(1.0, 10 ** ((each - 8) / 10)))) for each in decibels}
    found = {each: decided(seed, each, many[each]) for seed, each in enumerate(decibels)}
    wrong, chance = ({each: getattr(said, part) for each, said in found.items()} for part in Decided._fields)
    ratios = {name: [over(each[name], each[EXACT]) for each in chance.values()] for name in (PLAIN, TEMPERED)}
    return Compared.of(wrong, EXACT, ratios)


def picture(found: Compared) -> Any:
    """Draw error rates, and those of the chains over the exact one."""
    figure = new_figure(9, 4.2)
    left, right = figure.subplots(1, 2, width_ratios=(1.4, 1))
    found.draw(left)
    for name, pairs in found.ratios.items():
        ratio, error = np.array(pairs).T
        right.errorbar(found.decibels, ratio, SIGMAS * error, color=found.colors()[name], marker="o", markersize=3, linewidth=1.4)
    right.axhline(1, color=TRUE, linewidth=0.8)
    tidy(right)
    right.set(yscale="log", ylim=(0.5, None), xlabel="Eb/N0, dB", ylabel="errors over those of the exact detector")
    legend_below(figure, left, 4)
    return figure
