"""Counts of the paper, to the last printed digit, and where they differ from the algorithm."""

from fractions import Fraction

import pytest

import motes as mo
from data import refused
from motes.costs.flops import TABLE_I, kalman_measurement_update, particle_ratio

PAPER = mo.costs.Costs.paper()
FREE = mo.costs.Costs(0, 0, 0)
SIZES = [(p, k) for p in range(1, 8) for k in range(8)]


def printed(p, k, per_particle):
    return sum(line.printed(p, k) for line in TABLE_I if line.per_particle == per_particle)


def test_the_papers_constants():
    assert (PAPER.c1, PAPER.c2, PAPER.c3) == (445, 487, 125)


@pytest.mark.parametrize(("p", "k"), SIZES)
def test_table_sums_to_equation_11(p, k):
    """Except that (11) has 5 k^3 where the lines sum to 4 k^3."""
    fixed = mo.costs.complexity(p, k, 1, FREE) - (mo.costs.complexity(p, k, 2, FREE) - mo.costs.complexity(p, k, 1, FREE))
    assert fixed == pytest.approx(printed(p, k, False) + k**3, abs=1e-9)
    each = mo.costs.complexity(p, k, 2, mo.costs.Costs(1000, 200, 30)) - mo.costs.complexity(p, k, 1, mo.costs.Costs(1000, 200, 30))
    assert each == pytest.approx(printed(p, k, True) + 1200 + 30 * p, abs=1e-9)


def test_equation_14():
    """(14) in fractions: N_PF / N = 1 - (4 c3 + 56) / (c1 + c2 + 6 c3 + 150)."""
    share = 1 - Fraction(4 * 125 + 56, 445 + 487 + 6 * 125 + 150)
    assert particle_ratio(2, 4, PAPER) == pytest.approx(float(1 / share), rel=1e-12)
    assert f"{particle_ratio(2, 4, PAPER):.5f}" == "1.43574"
    assert f"{mo.costs.equivalent_particles(2, 4, 2000, PAPER):.1f}" == "2871.3"
    assert f"{particle_ratio(4, 2, PAPER) * 1000:.0f}" == "1179"


def test_equal_cost_is_equal():
    for measurement in ("nonlinear", "mixed"):
        for counts in ("paper", "corrected"):
            n = mo.costs.equivalent_particles(3, 4, 1500, PAPER, measurement, counts, 3)
            low, high = (mo.costs.complexity(3, 4, whole, PAPER, measurement, counts, 3) for whole in (int(n), int(n) + 1))
            assert low <= mo.costs.complexity(7, 0, 1500, PAPER, measurement, counts, 3) < high


def test_figure_1_always_gains():
    """Ratios above one that grow with the number of marginalized states; six states, four marginalized: 1.44."""
    for m in range(3, 10):
        curve = [particle_ratio(m - k, k, PAPER) for k in range(m - 1)]
        assert curve[0] == 1 and all(later > sooner for sooner, later in zip(curve, curve[1:], strict=False))


def test_figure_2_both_ways():
    assert f"{particle_ratio(2, 7, PAPER, 'mixed'):.3f}" == "0.882"
    assert f"{particle_ratio(2, 7, PAPER, 'mixed', plain='nonlinear'):.3f}" == "0.598"
    gains = {m: particle_ratio(2, m - 2, PAPER, "mixed") for m in range(3, 10)}
    assert gains[3] > 1 and gains[9] < 1
    # charged with what it does, the plain filter wins from six states on
    fair = {(m, k): particle_ratio(m - k, k, PAPER, "mixed", plain="nonlinear") for m in range(3, 10) for k in range(1, m - 1)}
    assert all(ratio < 1 for (m, _), ratio in fair.items() if m >= 6)


def test_corrected_counts():
    assert f"{particle_ratio(2, 4, PAPER, counts='corrected'):.4f}" == "1.4263"
    for p in range(1, 9):
        plain = mo.costs.complexity(p, 0, 11, FREE, counts="corrected") - mo.costs.complexity(p, 0, 10, FREE, counts="corrected")
        assert plain == 4 * p**2 - p
        # a plain filter has no covariance per particle, whatever is measured
        assert mo.costs.complexity(p, 0, 11, PAPER, "mixed", "corrected") == mo.costs.complexity(p, 0, 11, PAPER, counts="corrected")
    # all lines but T_6 and the constant of (11) agree
    for p, k in SIZES:
        if k:
            difference = mo.costs.complexity(p, k, 1, PAPER, counts="corrected") - mo.costs.complexity(p, k, 1, PAPER)
            assert difference == pytest.approx(-(k**3) + 2 * k**2 * p - k**2 - 2 * k * p**2 + k * p)


def test_products_count_their_multiplications_and_additions():
    """The corrected T_6 is L M (k, p)(p, p) and then (k, p)(p, k); a Kalman update is counted product by product."""

    def product(rows, inner, columns):
        return rows * inner * columns + rows * (inner - 1) * columns

    (line,) = [line for line in TABLE_I if line.code.startswith("T_6")]
    for p, k in SIZES:
        assert line.done(p, k) == product(k, p, p) + product(k, p, k)
    for r in range(1, 5):
        for k in range(1, 6):
            innovation_cov = product(r, k, k) + product(r, k, r) + r * r
            gain = r**3 + product(k, r, r)
            mean = product(r, k, 1) + 2 * r + product(k, r, 1) + k
            cov = product(k, r, k) + k * k
            assert kalman_measurement_update(k, r) == innovation_cov + gain + mean + cov
    assert kalman_measurement_update(4, 2) == 218


@pytest.mark.parametrize(("arguments", "words"), [
    ((0, 2, 10, PAPER), ("complexity p", "0")),
    ((2, -1, 10, PAPER), ("complexity k", "-1")),
    ((2, 1.5, 10, PAPER), ("complexity k", "1.5")),
    ((2, 1, 0, PAPER), ("complexity n", "0")),
    ((2, 1, 5, PAPER, "linear"), ("measurement", "'linear'")),
    ((2, 1, 5, PAPER, "mixed", "true"), ("counts", "'true'")),
    ((2, 1, 5, PAPER, "mixed", "corrected", 0), ("outputs", "0")),
])
def test_refusals(arguments, words):
    with pytest.raises(mo.MotesError) as error:
        mo.costs.complexity(*arguments)
    refused(error, *words)
