"""Equivalent flops of the marginalized particle filter (Karlsson, Schon, Gustafsson 2005: Table I, equations 11, 12 and 14).

A flop is one addition, subtraction, multiplication or division. What cannot be counted, a likelihood, the resampling of a particle, a
normal number, is charged with the number of flops that take the same time: the constants c1, c2, c3 of a machine (`calibrate` measures
them). One step of a filter with p states in particles, k states in Kalman filters and N particles then costs `a + b N`; a and b depend on p
and k alone.

The paper's equations are kept to the letter. `counts="corrected"` sums Table I as the algorithm really works: docs/costs.md lists what
differs.
"""

from collections.abc import Callable
from typing import NamedTuple

from motes.core import checks
from motes.core.record import record

Count = Callable[[int, int], float]


@record
class Costs:
    """What Table I cannot count, in equivalent flops.

    Attributes:
        c1: likelihood of one particle.
        c2: resampling of one particle.
        c3: one normal number.
    """

    c1: float
    c2: float
    c3: float

    @classmethod
    def paper(cls) -> "Costs":
        """The paper's machine: MATLAB on a Sun Blade 100."""
        return cls(445.0, 487.0, 125.0)


class Line(NamedTuple):
    """One line of Table I.

    Attributes:
        code: the instruction.
        per_particle: whether it is done for each particle (the other lines are, when each particle has a covariance of its own).
        printed: flops from (p, k), as printed; what c3 charges is left out.
        done: flops from (p, k) that are really done; None where that is what is printed.
        kalman: whether the line is there only with a Kalman part.
    """

    code: str
    per_particle: bool
    printed: Count
    done: Count | None = None
    kalman: bool = True


TABLE_I = (
    Line("P_A := P (A^k)'", False, lambda p, k: p * k**2 + (k - 1) * k * p),
    Line("M := A^k P_A + Q^p", False, lambda p, k: k * p**2 + (k - 1) * p**2 + p**2),
    Line("T_1 := chol(M)", False, lambda p, k: p**3 / 3 + 2 * p**2, kalman=False),
    Line("T_2 := randn(p, N)", True, lambda p, k: 0, kalman=False),
    Line("w := T_1 T_2", True, lambda p, k: p**2 + (p - 1) * p, kalman=False),
    Line("T_3 := A^p x^p", True, lambda p, k: p**2 + (p - 1) * p, kalman=False),
    Line("T_4 := A^k x^k", True, lambda p, k: p * k + (k - 1) * p),
    Line("x^p := T_3 + T_4 + w", True, lambda p, k: 2 * p, lambda p, k: 2 * p if k else p, kalman=False),
    Line("inv_M := M^-1", False, lambda p, k: p**3),
    Line("L := F^k P_A inv_M", False, lambda p, k: k**2 * p + k * p**2 + k**2 * p + p**2 * k - 2 * k * p),
    Line("T_5 := F^k P (F^k)'", False, lambda p, k: 2 * k**3 + 2 * (k - 1) * k**2),
    Line("T_6 := L M L'", False, lambda p, k: 2 * k * p**2 + 2 * (p - 1) * p * k,
         lambda p, k: k * p**2 + k**2 * p + k * p * (p - 1) + k**2 * (p - 1)),
    Line("P := T_5 + Q^k - T_6", False, lambda p, k: 2 * k**2),
    Line("T_7 := F^k x^k", True, lambda p, k: k**2 + (k - 1) * k),
    Line("T_8 := F^p x^p", True, lambda p, k: k * p + (p - 1) * k),
    Line("T_9 := x^p - T_3 - T_4", True, lambda p, k: 2 * p),
    Line("x^k := T_7 + T_8 + L T_9", True, lambda p, k: k * p + (p + 1) * k),
)  # fmt: skip
"""Table I of the paper: the time update of Algorithm 1."""


def kalman_measurement_update(k: int, outputs: int) -> float:
    """Flops to correct a mean and covariance of k states by a measurement of so many components (no line of Table I)."""
    r = outputs
    return 4 * r * k**2 + 4 * r**2 * k + 2 * r * k + r + r**3


def complexity(
    p: int, k: int, n: int, costs: Costs, measurement: str = "nonlinear", counts: str = "paper", outputs: int = 2
) -> float:
    """Equivalent flops of one step of the marginalized particle filter; with k = 0, of the plain one.

    Args:
        p: number of states in particles.
        k: number of states in Kalman filters.
        n: number of particles.
        costs: c1, c2, c3.
        measurement: "nonlinear" where the sensor does not see the Kalman part, so that one covariance serves all particles (equation 11),
            or
            "mixed" where it does, and each particle has its own (equation 12).
        counts: "paper" for the equations as printed, "corrected" for what the algorithm does.
        outputs: number of measured components; only the corrected count of a mixed measurement asks for it.

    Raises:
        MotesError: a number or a word is not a possible one.
    """
    checks.positive_integer("complexity n", n)
    fixed, per_particle = _linear(p, k, costs, measurement, counts, outputs)
    return fixed + per_particle * n


def equivalent_particles(
    p: int, k: int, n_particle_filter: int, costs: Costs, measurement: str = "nonlinear", counts: str = "paper", outputs: int = 2
) -> float:
    """Number of particles that the marginalized filter can have at the cost of a plain filter for all states (equation 14).

    Solves C(p, k, N) = C(p + k, 0, n_particle_filter) for N, both counted alike; see `complexity` for the arguments and errors. The paper's
    example, p = 2, k = 4 and 2 000 particles with its own costs, gives 2 871 (the paper prints 2 880, from a rounded ratio).
    """
    plain = complexity(p + k, 0, n_particle_filter, costs, measurement, counts, outputs)
    fixed, per_particle = _linear(p, k, costs, measurement, counts, outputs)
    return (plain - fixed) / per_particle


def particle_ratio(
    p: int, k: int, costs: Costs, measurement: str = "nonlinear", counts: str = "paper", outputs: int = 2, plain: str | None = None
) -> float:
    """Ratio of particle numbers at equal cost, many particles: the curves of figures 1 ("nonlinear") and 2 ("mixed"), with p = 2.

    Args:
        p: number of states in particles.
        k: number of states in Kalman filters.
        costs: c1, c2, c3.
        measurement: as for `complexity`.
        counts: as for `complexity`.
        outputs: as for `complexity`.
        plain: how the plain filter is counted; None for the same as `measurement`. Equation 12 charges a plain filter with a covariance per
            particle that it does not have; "nonlinear" spares it that. The paper does not say which it drew in figure 2.

    Raises:
        MotesError: a number or a word is not a possible one.
    """
    own = _linear(p, k, costs, measurement, counts, outputs)[1]
    return _linear(p + k, 0, costs, plain or measurement, counts, outputs)[1] / own


def _linear(p: int, k: int, costs: Costs, measurement: str, counts: str, outputs: int) -> tuple[float, float]:
    """Return cost without particles and cost per particle."""
    checks.positive_integer("complexity p", p)
    if k != 0:
        checks.positive_integer("complexity k", k)
    checks.positive_integer("complexity outputs", outputs)
    checks.option("complexity measurement", measurement, ("nonlinear", "mixed"))
    checks.option("complexity counts", counts, ("paper", "corrected"))
    fixed, per_particle = _equations(p, k) if counts == "paper" else _as_done(p, k)
    uncounted = p * costs.c3 + costs.c1 + costs.c2
    if measurement == "nonlinear" or (counts == "corrected" and k == 0):
        return fixed, per_particle + uncounted
    update = k**3 if counts == "paper" else kalman_measurement_update(k, outputs)
    return 0.0, per_particle + uncounted + fixed + update


def _equations(p: int, k: int) -> tuple[float, float]:
    """Equation 11, c1 to c3 left out."""
    fixed = 4 * p * k**2 + 8 * k * p**2 + 4 / 3 * p**3 + 5 * k**3 - 5 * k * p + 2 * p**2
    return fixed, 6 * k * p + 4 * p**2 + 2 * k**2 + p - k


def _as_done(p: int, k: int) -> tuple[float, float]:
    found = [0.0, 0.0]
    for line in TABLE_I:
        if k or not line.kalman:
            found[line.per_particle] += (line.done or line.printed)(p, k)
    return found[0], found[1]
