"""Pairing, and the same bits whatever the way there."""

import multiprocessing
import threading
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from study_models import BLOCKS, A, Q, bent, experiment, model

import motes as mo
from data import refused
from motes.core import engine
from motes.core.record import replace
from motes.core.settings import in_force
from motes.studies.store import Store
from motes.studies.work import TRUTH, Work

FACTORY = "study_models:experiment"


@pytest.fixture(scope="module")
def result():
    return mo.study(experiment())


def test_starved_runs_fill_no_screen(recwarn):
    found = mo.study(experiment(filters={"starved": mo.ParticleFilter(n=8)}))
    assert found.ess.min() < 1.6 and not [one for one in recwarn if issubclass(one.category, mo.MotesWarning)]


def test_runs_are_paired_and_can_be_repeated_one_by_one(result):
    plan = experiment()
    for number in (0, 7):
        world, filter = plan.keys(number)
        xs, ys = mo.simulate(world, plan.model, 7)
        np.testing.assert_array_equal(result.truth[number], xs)
        for place, name in enumerate(plan.filters):
            history = mo.run(filter, plan.filters[name], plan.model, ys)
            np.testing.assert_array_equal(result.estimates[place, number], history.mean)
            assert result.ess[place, number] == history.ess.min()
            assert result.log_likelihood[place, number] == history.log_likelihood
            errors, covs = np.asarray(history.mean - xs, np.float64), np.asarray(history.cov, np.float64)
            nees = [[e[i] @ np.linalg.solve(c[np.ix_(i, i)], e[i]) for i in ([0], [1, 0])] for e, c in zip(errors, covs, strict=True)]
            np.testing.assert_allclose(result.nees[place, number], nees, rtol=2e-4)
    assert len({truth.tobytes() for truth in result.truth}) == 10
    assert len({jax.random.key_data(key).tobytes() for number in range(10) for key in plan.keys(number)}) == 20


def test_further_filters_runs_and_another_order_change_nothing(result):
    filters = {"new": mo.ParticleFilter(n=33)} | dict(reversed(experiment().filters.items()))
    more = mo.study(experiment(runs=13, filters=filters))
    assert more.filters == ("new", "second", "first")
    np.testing.assert_array_equal(more.truth[:10], result.truth)
    for name in ("estimates", "nees", "ess", "log_likelihood"):
        np.testing.assert_array_equal(getattr(more, name)[[2, 1], :10], getattr(result, name))
    other = mo.study(experiment(runs=1, seed=4))
    assert (other.truth[0] != result.truth[0]).all()


@pytest.mark.parametrize("chunk", [1, 7, 64])
def test_chunks_change_no_bit(result, chunk):
    assert mo.study(experiment(), chunk=chunk) == result


class Backwards:
    """An executor that waits for a number of tasks, then works them off from the last to the first."""

    def __init__(self, tasks):
        self.tasks, self.waiting = tasks, []

    def submit(self, function, *arguments):
        future = Future()
        self.waiting.append((future, function, arguments))
        if len(self.waiting) == self.tasks:
            threading.Thread(target=self.work).start()
        return future

    def work(self):
        for future, function, arguments in reversed(self.waiting):
            future.set_result(function(*arguments))


def test_order_of_completion_changes_no_bit(result):
    assert mo.study(FACTORY, executor=Backwards(15), chunk=2) == result


@pytest.mark.night
def test_other_processes_give_the_same_bits(result, tmp_path):
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert mo.study(FACTORY, store=tmp_path, executor=pool, chunk=3) == result
    assert mo.studies.StudyResult.load(tmp_path) == result


def test_batches_of_an_accelerator_do_not_depend_on_chunks(result):
    work, settings = Work(experiment(), 4), in_force()
    whole = work.block(settings, "second", 0, 10)
    pieces = [work.block(settings, "second", start, stop) for start, stop in ((0, 3), (3, 4), (4, 10))]
    for name, values in whole.items():
        np.testing.assert_array_equal(np.concatenate([piece[name] for piece in pieces]), values)
    np.testing.assert_allclose(whole["estimates"], result.estimates[1], rtol=1e-3, atol=1e-3)
    np.testing.assert_array_equal(work.block(settings, TRUTH, 2, 9)["truth"].shape, (7, 7, 2))


def test_engine_and_precision_reach_the_threads(monkeypatch):
    def seen(experiment, part, number):
        return {"x": jnp.full(3, engine.chosen() == "native")}

    with jax.enable_x64(True):
        found = mo.study(experiment(runs=2, filters={"first": mo.ParticleFilter(n=9)}))
    assert found.truth.dtype == found.estimates.dtype == found.nees.dtype == np.float64 and dict(found.provenance)["float"] == "float64"
    monkeypatch.setattr("motes.studies.work.one_run", seen)
    with mo.engine("native"):
        settings = in_force()
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(Work(experiment(), 1).block, settings, "first", 0, 2).result()["x"].all()
        assert not pool.submit(Work(experiment(), 1).block, in_force(), "first", 0, 2).result()["x"].any()


def test_a_collapsed_run_stops_nothing():
    sure = mo.StateSpaceModel(
        model().initial, mo.LinearGaussian(A, Q), mo.AdditiveGaussian(bent, 1e-9 * np.eye(2)), ("a", "b"))
    filters = {"good": mo.ParticleFilter(n=40), "sure": (mo.ParticleFilter(n=40), sure),
               "goes on": (mo.ParticleFilter(n=40, on_collapse="predict"), sure)}
    found = mo.study(experiment(filters=filters))
    assert (found.collapsed[0] == -1).all() and not found.lost[0].any()
    assert (found.collapsed[1] >= 0).all() and found.lost[1].all()
    np.testing.assert_array_equal(found.collapsed[1], found.collapsed[2])
    assert not found.lost[2].any()
    with pytest.raises(mo.CollapseError, match=f"step {found.collapsed[1, 4]}:"):
        plan = experiment(filters=filters)
        mo.run(plan.keys(4)[1], filters["sure"][0], sure, plan.drawn(4)[1])
    table = found.table()
    assert table.column("lost") == [0, 0, 10, 10, 0, 0] and np.isnan(table.column("kept")[2]) and "-" in str(table)


def test_a_fixed_track_is_measured_anew_in_each_run():
    track = np.cumsum(np.ones((7, 2)), axis=0)
    plan = experiment(track=track)
    found = mo.study(plan)
    assert (found.truth == track.astype(np.float32)).all()
    ys = np.stack([plan.drawn(number)[1] for number in range(400)])
    noise = ys - np.stack([bent(x, None, 0) for x in jnp.asarray(track)]) - [0.1, 0.0]
    assert np.unique(noise).size > 5000
    # level 1e-6: 2 800 Laplacian numbers for each component, whose absolute values have mean and deviation equal to the scale
    for component, scale in ((0, 0.4), (1, 0.7)):
        mean = np.abs(noise[..., component]).mean()
        assert abs(mean - scale) < 4.9 * scale / np.sqrt(2_800)


def test_measurements_of_a_track_are_those_that_came_with_it():
    plan = experiment()
    xs, ys = plan.drawn(2)
    again = experiment(track=xs).drawn(2)[1]
    np.testing.assert_allclose(again, ys, rtol=1e-6)


def test_inputs_and_angles():
    turn = mo.StateSpaceModel(
        mo.Gaussian([3.0], [[0.01]]), mo.AdditiveGaussian(lambda x, u, t: x + u["rate"], [[0.01]], angles=(0,)),
        mo.AdditiveGaussian(lambda x, u, t: jnp.stack([jnp.cos(x[0]), jnp.sin(x[0])]), 0.05 * np.eye(2)), ("heading",))
    inputs = {"rate": np.linspace(0.0, 1.0, 20)}
    found = mo.study(mo.Experiment(turn, {"pf": mo.ParticleFilter(n=300)}, steps=20, runs=4, inputs=inputs))
    np.testing.assert_allclose(np.diff(found.truth[:, :, 0]), np.tile(inputs["rate"][1:], (4, 1)), atol=0.6)
    shifted = replace(found, estimates=found.estimates + 4 * np.pi)
    np.testing.assert_allclose(shifted.errors("heading"), found.errors("heading"), atol=1e-5)
    assert np.abs(found.errors("heading")).max() < 2


def test_interruption_says_how_to_go_on(tmp_path, monkeypatch, result):
    keep, calls = Store.put, []

    def interrupted(self, *block):
        if len(calls) == 4:
            raise KeyboardInterrupt
        calls.append(block[:3])
        keep(self, *block)

    monkeypatch.setattr(Store, "put", interrupted)
    with pytest.raises(KeyboardInterrupt, match=r"interrupted; \d+ of 20 runs are in .*The same call goes on from there"):
        mo.study(experiment(), store=tmp_path, chunk=2)
    monkeypatch.setattr(Store, "put", lambda self, *block: (calls.append(block[:3]), keep(self, *block)))
    assert mo.study(experiment(), store=tmp_path, chunk=3) == result
    runs = [(part, number) for part, start, stop in calls for number in range(start, stop)]
    assert len(runs) == len(set(runs)) == 30


def test_progress_bar(capsys):
    mo.study(experiment(runs=2), progress=True)
    assert "4/4" in capsys.readouterr().err
    mo.study(experiment(runs=2))
    assert capsys.readouterr().err == ""


def build(**changes):
    return lambda: experiment(**changes)


REFUSED = {
    "steps": (build(steps=0), "Experiment steps: expected a whole number of at least 1, got 0"),
    "runs": (build(runs=2.5), "Experiment runs: expected a whole number of at least 1, got 2.5"),
    "seed": (build(seed=-1), "Experiment seed: expected a whole number from 0 to 4294967295, got -1"),
    "model": (lambda: mo.Experiment(3, {"a": mo.ParticleFilter(n=3)}, 5, 5), "Experiment model: expected a StateSpaceModel"),
    "no filter": (lambda: mo.Experiment(model(), {}, 5, 5), "Experiment filters: expected names and filters"),
    "kind of filter": (build(filters={"a": 4}), "Experiment filters 'a': expected a filter, or a pair of a filter and a model, got int"),
    "name": (build(filters={"a\nb": mo.ParticleFilter(n=3)}), "Experiment filters: expected names of 1 to 60 printable characters"),
    "assumed model": (
        build(filters={"a": (mo.ParticleFilter(n=3), mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.LinearGaussian([[1.0]], [[1.0]]),
                                                                        mo.LinearGaussian([[1.0]], [[1.0]])))}),
        "Experiment filters 'a': expected a model with the states of the world, a, b, got x0"),
    "inputs": (build(inputs=np.ones(3)), "Experiment inputs: expected arrays with the time axis first, 7 steps, got first axes ['3']"),
    "track": (build(track=np.ones((7, 3))), "Experiment track: expected shape (7, 2) (steps, states), got shape (7, 3)"),
    "track with holes": (build(track=np.full((7, 2), np.nan)), "Experiment track: expected finite numbers"),
    "block": (build(blocks={"place": ("a", "c")}), "Experiment blocks 'place': expected different states out of a, b, got ['a', 'c']"),
    "blocks": (build(blocks=7), "Experiment blocks: expected names and states"),
    "lost": (build(lost=("speed", 3.0)), "Experiment lost: expected a block (place, both) and a positive limit"),
    "filter and model": (
        lambda: mo.study(experiment(filters={"kf": mo.KalmanFilter()})),
        "filter 'kf': KalmanFilter model: expected a linear-Gaussian model"),
    "no experiment": (lambda: mo.study(model()), "study experiment: expected an Experiment, or the name of a function"),
    "no such function": (lambda: mo.study("study_models:nothing"), "study experiment: expected an experiment, or the name of a function"),
    "wrong function": (lambda: mo.study("study_models:wrong_kind"), "expected a function that returns an Experiment, got int"),
    "executor": (lambda: mo.study(FACTORY, executor=3), "study executor: expected what has submit"),
    "functions cannot travel": (
        lambda: mo.study(experiment(), executor=ThreadPoolExecutor(1)), "study experiment: expected the name of a function that makes it"),
    "fork": (
        lambda: mo.study(FACTORY, executor=ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("fork"))),
        "study executor: expected processes that are spawned, got forked ones"),
    "chunk": (lambda: mo.study(experiment(), chunk=0), "study chunk: expected a whole number of at least 1, got 0"),
    "correlated noise of a track": (
        lambda: mo.study(mo.Experiment(mo.StateSpaceModel(
            mo.Gaussian([0.0, 0.0], np.eye(2)), mo.LinearGaussian(A, Q), mo.LinearGaussian(np.eye(2), np.eye(2)),
            noise_cross_cov=0.1 * np.eye(2)), {"pf": mo.ParticleFilter(n=9)}, 7, 2, track=np.ones((7, 2)))),
        "model: expected measurement noise that is independent of the process noise"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refusals(name):
    attempt, message = REFUSED[name]
    with pytest.raises(mo.MotesError) as error:
        attempt()
    refused(error, message)


def test_blocks_are_each_state_unless_named():
    assert experiment(blocks=None).blocks == (("a", ("a",)), ("b", ("b",)))
    assert experiment().blocks == tuple(BLOCKS.items())
