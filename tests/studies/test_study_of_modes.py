"""Studies whose world jumps among modes, and filters whose model has more states than the world."""

import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from data import refused


def walk(speed):
    dynamics, sensor = mo.LinearGaussian([[speed]], [[0.2]]), mo.LinearGaussian([[1.0]], [[0.5]])
    return mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), dynamics, sensor, ("place",))


def world(stay=0.9):
    """A target that comes to rest or runs away; its place is measured."""
    return mo.JumpMarkovModel([0.5, 0.5], [[stay, 1 - stay], [0.2, 0.8]], (walk(0.5), walk(1.3)))


def plan(model, **changes):
    filters = {"modes": mo.InteractingMultipleModel(), "joined": (mo.ParticleFilter(n=60), model.as_state_space())}
    return mo.Experiment(model, filters, **({"steps": 5, "runs": 2, "seed": 4} | changes))


@pytest.mark.night
def test_a_world_of_modes_is_studied_and_kept(tmp_path):
    model = world()
    experiment = plan(model)
    result = mo.study(experiment, store=tmp_path)
    assert result.states == ("place",) and result.truth.shape == (2, 5, 1) and result.estimates.shape == (2, 2, 5, 1)
    world_key, filter_key = experiment.keys(1)
    xs, ys = mo.simulate(world_key, model, 5)
    np.testing.assert_array_equal(result.truth[1], xs[:, :1])
    assert set(np.asarray(xs[:, 1]).tolist()) <= {0.0, 1.0}
    for number, name in enumerate(experiment.filters):
        history = mo.run(filter_key, *experiment.assumed(name), ys)
        np.testing.assert_array_equal(result.estimates[number, 1], history.mean[:, :1])
        square = np.asarray((history.mean - xs[:, : history.mean.shape[1]])[:, 0] ** 2 / history.cov[:, 0, 0])
        np.testing.assert_allclose(result.nees[number, 1, :, 0], square, rtol=1e-4)
    assert mo.studies.StudyResult.load(tmp_path) == result
    with pytest.raises(mo.FileError, match="model transition"):
        mo.study(plan(world(stay=0.7)), store=tmp_path)


def test_a_track_of_such_a_world_says_the_mode_too():
    model = world()
    xs = jnp.stack([jnp.linspace(0.0, 1.0, 5), jnp.array([0.0, 0.0, 1.0, 1.0, 0.0])], axis=1)
    states, ys = plan(model, track=xs).drawn(0)
    assert states.shape == (5, 1) and ys.shape == (5, 1)
    with pytest.raises(mo.MotesError) as error:
        plan(model, track=xs[:, :1])
    refused(error, "Experiment track", (5, 2))


def test_a_filter_may_have_states_beside_those_of_the_world_but_must_have_them_all():
    place = walk(0.9)
    biased = mo.StateSpaceModel(mo.Gaussian([0.0, 0.0], np.diag([0.04, 1.0])), mo.LinearGaussian(np.diag([1.0, 0.9]), np.diag([0.0, 0.3])),
                                mo.LinearGaussian([[1.0, 1.0]], [[0.5]]), ("bias", "place"))  # fmt: skip
    experiment = mo.Experiment(place, {"biased": (mo.KalmanFilter(), biased)}, steps=4, runs=1)
    result = mo.study(experiment)
    history = mo.run(experiment.keys(0)[1], mo.KalmanFilter(), biased, experiment.drawn(0)[1])
    np.testing.assert_array_equal(result.estimates[0, 0], history.mean[:, 1:])
    with pytest.raises(mo.MotesError) as error:
        mo.Experiment(biased, {"small": (mo.KalmanFilter(), place)}, steps=4, runs=1)
    refused(error, "a model with the states of the world, bias, place", "place")
    with pytest.raises(mo.MotesError) as error:
        mo.Experiment(world(), {"modes": mo.InteractingMultipleModel(), "no model": (mo.KalmanFilter(), 3)}, steps=4, runs=1)
    refused(error, "Experiment filters 'no model' model", "JumpMarkovModel", "int")
