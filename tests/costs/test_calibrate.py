"""Regressions on times that are known, what is kept between calls, and what the command prints. No test looks at a real clock's numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import linregress, t

import motes as mo
from data import refused
from motes.cli.main import main
from motes.costs import calibration as room
from motes.costs.calibration import PARTICLES, Slope
from motes.costs.measure import least_seconds
from tiers import each


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine whose operations take 5 us and 2 ns for each number that they return; counts what is timed."""
    timed = []

    def seconds(call, repeats=1):
        shapes = jax.eval_shape(call)
        timed.append(sum(np.prod(leaf.shape) for leaf in jax.tree.leaves(shapes)))
        return 5e-6 + 2e-9 * timed[-1]

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(room, "least_seconds", seconds)
    return timed


def files(tmp_path):
    return list((tmp_path / "motes" / "calibrations").iterdir())


def test_slope_is_the_regression_of_the_textbook():
    rng = np.random.default_rng(3)
    units = np.array([1, 2, 4, 7, 9, 12]) * 1e3
    seconds = 3e-5 + 2e-9 * units + rng.normal(size=6) * 1e-6
    found, expected = Slope.fitted(units, seconds), linregress(units, seconds)
    half = t.ppf(0.975, 4) * expected.stderr
    np.testing.assert_allclose(
        [found.value, found.low, found.high, found.r_squared],
        [expected.slope, expected.slope - half, expected.slope + half, expected.rvalue**2],
    )


def test_ratio_of_slopes_covers_the_truth():
    """A 95% interval holds the ratio in 95% of repetitions; 99.9999% limits for 3000 of them."""
    rng = np.random.default_rng(0)
    units = np.linspace(1, 10, 12)
    hits = 0
    for _ in range(3000):
        own, unit = (Slope.fitted(units, 4 + b * units + rng.normal(size=12) * s) for b, s in ((6.0, 1.0), (2.0, 0.3)))
        ratio = own.over(unit)
        hits += ratio.low < 3 < ratio.high
    assert abs(hits / 3000 - 0.95) < 4.9 * np.sqrt(0.95 * 0.05 / 3000) + 0.005


def test_constants_of_a_known_machine(machine, tmp_path):
    found = mo.costs.calibrate()
    # normal numbers: one returned per number; weighing returns the cloud, 6 states, weight and ancestor, and six numbers in all
    assert found.normal.value == pytest.approx(2e-9) and found.normal.r_squared == pytest.approx(1)
    assert found.likelihood.value == pytest.approx(8 * 2e-9) and found.resampling.value == pytest.approx(8 * 2e-9)
    # products of (2, 2), (2, 4) and (4, 4) with n columns, there and back, 50 times
    n, sizes = np.array(PARTICLES), ((2, 2), (2, 4), (4, 4))
    flops = np.concatenate([50 * (i * (2 * j - 1) + j * (2 * i - 1)) * n for i, j in sizes])
    products = np.concatenate([5e-6 + 2e-9 * j * n for _, j in sizes])
    assert found.flop.value == pytest.approx(linregress(flops, products).slope)
    assert found.costs.c3 == pytest.approx(found.normal.value / found.flop.value)
    assert found.costs == mo.costs.Costs(*(slope.value for slope in found.equivalent_flops.values()))
    assert found.engine == "auto" and "cpu" in found.device


def test_kept_and_measured_again(machine, tmp_path):
    first = mo.costs.calibrate()
    count = len(machine)
    assert mo.costs.calibrate() == first and len(machine) == count
    assert len(files(tmp_path)) == 1
    mo.costs.calibrate(refresh=True)
    assert len(machine) == 2 * count
    # another model, another file
    other = mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.LinearGaussian([[0.9]], [[1.0]]), mo.LinearGaussian([[1.0]], [[0.5]]))
    assert mo.costs.calibrate(other).likelihood.value == pytest.approx(3 * 2e-9)
    assert len(files(tmp_path)) == 2


@pytest.mark.parametrize("damage", each(["cut", "flipped", "other table"], {"cut", "flipped"}))
def test_damaged_files_are_replaced_with_one_line(machine, tmp_path, damage):
    first = mo.costs.calibrate()
    (path,) = files(tmp_path)
    whole = bytearray(path.read_bytes())
    if damage == "other table":
        from motes.io.archive import write_tree

        write_tree(path, {"table": np.zeros((2, 4))}, {}, kind="calibration")
    else:
        whole[len(whole) // 2] ^= 255
        path.write_bytes(whole if damage == "flipped" else whole[: len(whole) // 2])
    with pytest.warns(UserWarning, match="measured again") as lines:
        assert mo.costs.calibrate() == first
    assert len(lines) == 1 and str(path) in str(lines[0].message) and "\n" not in str(lines[0].message)
    assert mo.costs.calibrate() == first  # without a warning


def test_nothing_is_kept_where_it_cannot_be(machine, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/none")
    mo.costs.calibrate()
    count = len(machine)
    mo.costs.calibrate()
    assert len(machine) == 2 * count


def test_a_busy_machine_is_refused(machine, monkeypatch):
    monkeypatch.setattr(room, "least_seconds", lambda call, repeats=1: 1e-3 - 1e-12 * jax.tree.leaves(jax.eval_shape(call))[0].size)
    with pytest.raises(mo.MotesError) as error:
        mo.costs.calibrate()
    refused(error, "calibrate flop", "idle")


def test_command(machine, capsys, tmp_path):
    assert main(["calibrate"]) == 0
    text = capsys.readouterr().out
    for word in ("c1", "c2", "c3", "445", "487", "125", "95% interval", "R squared", "one flop takes", "engine auto"):
        assert word in text, text
    (path,) = files(tmp_path)
    path.write_bytes(b"PK")
    assert main(["calibrate"]) == 0
    said = capsys.readouterr()
    assert said.err.startswith("motes calibrate: ") and said.err.count("\n") == 1 and "measured again" in said.err
    assert main(["calibrate", "--engine", "x"]) == 2


def test_times_are_the_least_and_wait_for_the_results(monkeypatch):
    calls = []

    def least_of(durations, repeats):
        ticks = iter(np.cumsum([0.0, *(tick for duration in durations for tick in (duration, 9.0))]))
        monkeypatch.setattr("motes.costs.measure.time.perf_counter", lambda: next(ticks))
        calls.clear()
        return least_seconds(lambda: calls.append(1) or jnp.ones(3), repeats)

    assert least_of([3.0, 1.0, 2.0, 0.5], 3) == pytest.approx(1.0) and len(calls) == 4
    # short calls are repeated longer, until 0.2 s have passed
    assert least_of([0.06, 0.05, 0.06, 0.07, 0.01], 2) == pytest.approx(0.05) and len(calls) == 5


@pytest.fixture
def walk():
    return mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.LinearGaussian([[0.9]], [[1.0]]), mo.LinearGaussian([[1.0]], [[0.5]]))


@pytest.fixture
def clock(monkeypatch):
    """A machine on which a run takes 100 us, a first step 30 us, each further step 4 us and 10 ns for each particle."""

    def seconds(call, repeats, span):
        history = jax.eval_shape(call)
        return 130e-6 + (4e-6 + 1e-8 * history.state.log_weights.shape[0]) * (history.ess.shape[0] - 1)

    monkeypatch.setattr("motes.costs.measure.least_seconds", seconds)


def test_seconds_of_a_step_leave_out_what_happens_once(clock, walk):
    assert mo.costs.seconds_per_step(mo.ParticleFilter(n=100), walk, np.zeros((40, 1))) == pytest.approx(5e-6)
    with pytest.raises(mo.MotesError) as error:
        mo.costs.seconds_per_step(mo.ParticleFilter(n=100), walk, np.zeros((1, 1)))
    refused(error, "at least two measurements", "1")


def test_line_through_known_times(clock, walk):
    found = mo.costs.fit_step_time(mo.ParticleFilter(n=7), walk, np.zeros((9, 1)), particles=(100, 500, 3000))
    assert (found.fixed, found.per_particle) == pytest.approx((4e-6, 1e-8))
    assert np.abs(found.residuals).max() < 1e-9 and [n for n, _ in found.measured] == [100, 500, 3000]
    assert found.seconds(2000) == pytest.approx(24e-6) and found.particles(24.001e-6) == 2000
    for attempt, words in (
        (lambda: found.particles(4e-6), ("budget", "4.01e-06 s", "4e-06 s")),
        (lambda: mo.costs.fit_step_time(mo.KalmanFilter(), walk, np.zeros((9, 1))), ("number of particles n", "KalmanFilter")),
        (lambda: mo.costs.fit_step_time(mo.ParticleFilter(n=7), walk, np.zeros((9, 1)), particles=(5, 5)), ("different", "[5, 5]")),
        (lambda: mo.costs.fit_step_time(mo.ParticleFilter(n=7), walk, np.zeros((9, 1)), particles=(5, 0)), ("at least 1", "0")),
        (lambda: mo.costs.StepTime.fitted(((10, 2e-6), (20, 1e-6))), ("grow", "idle")),
    ):
        with pytest.raises(mo.MotesError) as error:
            attempt()
        refused(error, *words)


def test_line_weighs_relative_errors_and_has_no_negative_part():
    # three points off a line: the normal equations of relative errors, solved by hand with numpy
    n, seconds = np.array([1.0, 10, 100]), np.array([3.0, 9, 120])
    rows = np.stack([1 / seconds, n / seconds], axis=1)
    expected = np.linalg.solve(rows.T @ rows, rows.T @ np.ones(3))
    found = mo.costs.StepTime.fitted(tuple(zip((1, 10, 100), seconds, strict=True)))
    assert (found.fixed, found.per_particle) == pytest.approx(tuple(expected))
    assert min(found.residuals) < 0 < max(found.residuals)
    steep = mo.costs.StepTime.fitted(((10, 1e-6), (20, 4e-6)))
    # through zero: the sum of n / s over the sum of its squares
    assert steep.fixed == 0 and steep.per_particle == pytest.approx(1.5e7 / 1.25e14)
