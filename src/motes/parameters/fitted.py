"""What `mo.fit` gives: estimates with their standard errors, the fitted model, and how far to trust them."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from motes.core import checks, markdown
from motes.core.record import record, replace, static
from motes.io import archive
from motes.io.result_table import Table
from motes.parameters.named import grouped


@record
class Fit:
    """What `mo.fit` gives.

    Attributes:
        values: the estimates, and the parameters that were held, `(p,)`.
        covariance: of the estimates, `(p, p)`: inverse of the observed information, taken through bounds by the delta method; 0 where a
            parameter was held, NaN where it is not known.
        log_likelihood: of the measurements at these.
        measured: number of steps that count and at which something was measured.
        simulation_error: standard deviations `(p,)` of the estimates over random numbers, where the likelihood is by simulation; else None.
        model: the fitted model.
        rounds: evaluations of derivatives, or of expectation maximization.
        names: of the p numbers.
        held: which of them were held.
        groups: name and shape of each entry of the dictionary that `model_of` takes.
        converged: whether they are at a maximum.
        message: the same in words.
        method: what was done.
        filter: by which filter, as it prints.
    """

    values: np.ndarray
    covariance: np.ndarray
    log_likelihood: float
    measured: int
    simulation_error: np.ndarray | None
    model: Any
    rounds: int
    names: tuple[str, ...] = static()
    held: tuple[bool, ...] = static()
    groups: tuple[tuple[str, tuple[int, ...]], ...] = static()
    converged: bool = static()
    message: str = static()
    method: str = static()
    filter: str = static()

    @property
    def parameters(self) -> dict[str, Any]:
        """Estimates by name, numbers or arrays as they were given; what was held among them."""
        return self._by_name(self.values)

    @property
    def standard_errors(self) -> dict[str, Any]:
        """Standard errors by name; 0 of what was held, NaN where they are not known."""
        return self._by_name(self._deviations())

    def _by_name(self, numbers: np.ndarray) -> dict[str, Any]:
        return {name: float(value) if value.ndim == 0 else value for name, value in grouped(self.groups, numbers).items()}

    def _deviations(self) -> np.ndarray:
        return np.sqrt(np.diag(self.covariance))

    @property
    def free(self) -> int:
        """Number of parameters that were estimated."""
        return sum(not one for one in self.held)

    @property
    def aic(self) -> float:
        """Akaike's information criterion, -2 log L + 2 k."""
        return -2 * self.log_likelihood + 2 * self.free

    @property
    def bic(self) -> float:
        """Schwarz's information criterion, -2 log L + k log(number of measured steps)."""
        return -2 * self.log_likelihood + self.free * float(np.log(self.measured))

    def summary(self, level: float = 0.95) -> Table:
        """Return a table of estimates, standard errors, z = estimate / standard error, P(|Z| > |z|), and the ends of intervals.

        Args:
            level: of the intervals, estimate -+ quantile of the normal law * standard error.

        Raises:
            MotesError: the level does not lie between 0 and 1.
        """
        checks.probability("summary level", level)
        tail = (1 - level) / 2
        far = float(ndtri(1 - tail))
        columns = ["parameter", "estimate", "std. error", "z", "P>|z|", f"{100 * tail:g} %", f"{100 * (1 - tail):g} %"]
        rows: list[tuple[Any, ...]] = []
        for name, held, value, deviation in zip(self.names, self.held, self.values.tolist(), self._deviations().tolist(), strict=True):
            if held or not deviation > 0:
                rows.append((name, value, "held" if held else None, *[None] * 4))
            else:
                z = value / deviation
                rows.append((name, value, deviation, z, float(2 * ndtr(-abs(z))), value - far * deviation, value + far * deviation))
        if self.simulation_error is not None:
            columns.append("simulation error")
            rows = [(*row, error or None) for row, error in zip(rows, self.simulation_error.tolist(), strict=True)]
        return Table(tuple(columns), tuple(rows))

    def __str__(self) -> str:
        """Print what was done and how it went, and the table."""
        return "\n".join([*(f"{what:<16}{text}" for what, text in self._facts()), str(self.summary())])

    def _repr_markdown_(self) -> str:
        return f"{markdown.table(('', 'fit'), self._facts())}\n{self.summary().to_markdown()}"

    def _facts(self) -> list[tuple[str, str]]:
        """Return what was done and how it went, each with its name."""
        return [
            ("method", self.method), ("filter", self.filter), ("steps measured", str(self.measured)),
            ("log likelihood", f"{self.log_likelihood:.8g}"), ("AIC, BIC", f"{self.aic:.8g}, {self.bic:.8g}"),
            ("converged", f"{'yes' if self.converged else 'NO'}, in {self.rounds} rounds: {self.message}"),
        ]  # fmt: skip

    def save(self, path: str | Path) -> Path:
        """Write to a `.npz` file, all but the model.

        Raises:
            FileError: the ending is another, or the file cannot be written.
        """
        path = archive.npz_path(path)
        error = np.zeros(0) if self.simulation_error is None else self.simulation_error
        tree = {"values": self.values, "covariance": self.covariance, "simulation_error": error,
                "numbers": np.array([self.log_likelihood, self.measured, self.rounds])}  # fmt: skip
        texts = {"names": list(self.names), "held": list(self.held), "groups": [[name, list(shape)] for name, shape in self.groups]}
        texts |= {name: getattr(self, name) for name in ("converged", "message", "method", "filter")}
        return archive.write_tree(path, tree, texts, kind="fit")

    @classmethod
    def load(cls, path: str | Path, model_of: Callable[[Any], Any] | None = None) -> "Fit":
        """Read a fit back.

        Args:
            path: of the file.
            model_of: the function that was fitted; without it the model is None.

        Raises:
            FileError: the file holds no fit, or is damaged.
        """
        path = Path(path)
        tree, texts = archive.read_tree(path, "fit", lambda forms, texts: _check_forms(path, forms, texts))
        groups = tuple((name, tuple(shape)) for name, shape in texts["groups"])
        height, measured, rounds = tree["numbers"].tolist()
        error = tree["simulation_error"] if tree["simulation_error"].size else None
        found = cls(tree["values"], tree["covariance"], height, int(measured), error, None, int(rounds), tuple(texts["names"]),
                    tuple(texts["held"]), groups, *(texts[name] for name in ("converged", "message", "method", "filter")))  # fmt: skip
        return found if model_of is None else replace(found, model=model_of(found.parameters))


def _check_forms(path: Path, forms: dict[str, Any], texts: dict[str, Any]) -> None:
    """Refuse a file whose arrays or words cannot be those of a fit, before they are read."""
    if not _are_words(texts):
        checks.refuse(f"{path}: texts", "names of parameters and words", "others", "Restore it from a copy.", checks.FileError)
    count = len(texts["names"])
    archive.agree(path, forms, {"values": ((count,), "f"), "covariance": ((count, count), "f"), "numbers": ((3,), "f"),
                                "simulation_error": ((None,), "f")})  # fmt: skip


def _are_words(texts: dict[str, Any]) -> bool:
    """Tell whether words can be those of a fit, with as many names as its entries have numbers."""
    lists: list[Any] = [texts.get(name) for name in ("names", "held", "groups")]
    if not all(isinstance(one, list) for one in lists):
        return False
    names, held, groups = lists
    words = (*names, *(texts.get(name) for name in ("message", "method", "filter")))
    kinds = all(isinstance(one, str) for one in words) and all(isinstance(one, bool) for one in (*held, texts.get("converged")))
    if not kinds or not all(isinstance(one, list) and len(one) == 2 and _is_entry(*one) for one in groups):
        return False
    return len(held) == len(names) == sum(math.prod(shape) for _, shape in groups)


def _is_entry(name: Any, shape: Any) -> bool:
    return isinstance(name, str) and isinstance(shape, list) and all(type(length) is int and length >= 0 for length in shape)
