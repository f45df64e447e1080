"""Error rates that are counted, with bands that know of errors that come together; their table and curves."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

import motes as mo
from motes.plotting.figures import COLORS, TRUE, tidy

SIGMAS = 1.96
"""Bands hold the rate with a probability of 95 percent."""


class Rate(NamedTuple):
    """An error rate, and the ends of its band."""

    rate: float
    low: float
    high: float


def counted(wrong: Any) -> Rate:
    """Count errors in `(blocks, bits)`; bits of one block may go wrong together.

    The band is that of Wilson (1927) for as many independent bits as the variance between blocks leaves (Korn, Graubard 1998).
    """
    wrong = np.asarray(wrong, float)
    blocks, p, n = len(wrong), wrong.mean(), wrong.size
    alone, together = p * (1 - p) / n, wrong.mean(axis=1).var(ddof=1) / blocks
    n = n * alone / together if together > alone else n
    middle = (p + SIGMAS**2 / (2 * n)) / (1 + SIGMAS**2 / n)
    half = SIGMAS / (1 + SIGMAS**2 / n) * np.sqrt(p * (1 - p) / n + SIGMAS**2 / (4 * n**2))
    return Rate(float(p), float(middle - half), float(middle + half))


def over(wrong: Any, others: Any) -> tuple[float, float]:
    """Return the ratio of two error rates on the same blocks and its standard error; NaN where nothing is wrong.

    Args:
        wrong: errors, or their probabilities, `(blocks, bits)`.
        others: those to compare with.
    """
    one, other = (np.asarray(each, float).mean(axis=1) for each in (wrong, others))
    if not other.any():
        return float("nan"), float("nan")
    ratio = one.mean() / other.mean()
    return float(ratio), float((one - ratio * other).std(ddof=1) / len(one) ** 0.5 / other.mean())


class Compared(NamedTuple):
    """Errors of several receivers at several noises.

    Attributes:
        decibels: Eb/N0.
        rates: of each receiver, at each of these.
        ratios: of some receivers, of their error rate over that of the reference on the same data, with standard errors.
        reference: the receiver that none can beat.
    """

    decibels: tuple[float, ...]
    rates: dict[str, list[Rate]]
    ratios: dict[str, list[tuple[float, float]]]
    reference: str

    @classmethod
    def of(cls, wrong: Mapping[float, Mapping[str, Any]], reference: str, ratios: dict[str, list[tuple[float, float]]]) -> "Compared":
        """Count what is wrong `(blocks, bits)` at each noise by each receiver."""
        names = tuple(next(iter(wrong.values())))
        rates = {name: [counted(each[name]) for each in wrong.values()] for name in names}
        return cls(tuple(wrong), rates, ratios, reference)

    def table(self) -> mo.io.Table:
        """Return the rates as a table, a row for each receiver."""
        rows = [(name, *(each.rate for each in rates)) for name, rates in self.rates.items()]
        for name, pairs in self.ratios.items():
            rows.append((f"{name}: over {self.reference}", *(ratio for ratio, _ in pairs)))
            rows.append(("  its standard error", *(error for _, error in pairs)))
        return mo.io.Table(("wrong bits at an Eb/N0 of", *(f"{each} dB" for each in self.decibels)), tuple(rows))

    def colors(self) -> dict[str, str]:
        """Return a color for each receiver, black for the reference."""
        others = [name for name in self.rates if name != self.reference]
        return {self.reference: TRUE, **dict(zip(others, COLORS, strict=False))}

    def draw(self, axes: Any) -> None:
        """Draw rates over decibels with their bands; of a rate of zero the band alone."""
        for name, each in self.rates.items():
            rate, low, high = (np.array(part) for part in zip(*each, strict=True))
            color = self.colors()[name]
            own: dict[str, Any] = {"linestyle": "--", "zorder": 3} if name == self.reference else {"marker": "o", "markersize": 3}
            axes.fill_between(self.decibels, np.maximum(low, 1e-9), high, color=color, alpha=0.1, linewidth=0)
            axes.plot(self.decibels, np.where(rate > 0, rate, np.nan), color=color, linewidth=1.4, label=name, **own)
        tidy(axes)
        least = min(each.rate for rates in self.rates.values() for each in rates if each.rate)
        axes.set(yscale="log", xlabel="Eb/N0, dB", ylabel="share of bits that are wrong", xlim=(self.decibels[0], self.decibels[-1]))
        axes.set_ylim(0.4 * least, 0.3)
