"""A history that was saved and loaded can be continued, smoothed and diagnosed as the one that was not; where not, one line says so."""

import json
import zipfile
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from contract.discovery import examples, first_of_kinds, kind_of
from motes.filters import history as histories
from motes.testing.models import linear
from tiers import each

MODEL = linear()
YS = np.array(mo.simulate(0, MODEL, 6)[1])
QUIET = pytest.mark.filterwarnings("ignore::motes.MotesWarning")


def shaped(filter, steps=4):
    """A history of a run, from shapes alone: nothing is compiled."""
    like = jax.eval_shape(lambda ys: mo.run(0, filter, MODEL, ys, keep=mo.keep.laws), YS[:steps])
    return jax.tree.map(lambda leaf: jnp.ones(leaf.shape, leaf.dtype), like)


KNOWN = [name for name, filter in examples().items() if kind_of(filter)[0].__module__.startswith("motes.laws.")]
"""Filters whose laws files name; other laws, as of a user's own, come back as dictionaries."""
KINDS = first_of_kinds(examples())


@pytest.mark.parametrize("name", each(KNOWN, lambda name: name not in KINDS))
def test_laws_of_every_filter_come_back(name, tmp_path):
    history = shaped(examples()[name])
    loaded = mo.History.load(history.save(tmp_path / "h.npz"))
    assert jax.tree.structure((history.kept, history.last)) == jax.tree.structure((loaded.kept, loaded.last))
    for one, other in zip(jax.tree.leaves(history), jax.tree.leaves(loaded), strict=True):
        np.testing.assert_array_equal(one, other)
        assert one.dtype == other.dtype
    assert str(mo.diagnose(history)) == str(mo.diagnose(loaded))


SMOOTHED = {
    "KalmanFilter": [mo.smoothers.RauchTungStriebelSmoother(), mo.smoothers.BackwardSimulationSmoother(5)],
    "ParticleFilter": [mo.smoothers.GenealogySmoother(), mo.smoothers.BackwardSimulationSmoother(5)],
    "MarginalizedParticleFilter, one state": [mo.smoothers.RaoBlackwellizedSmoother(5)],
    "JumpMarkovFilter": [mo.smoothers.MixtureSmoother(5)],
}


def outcome(call):
    try:
        return np.asarray(call())
    except mo.MotesError as refusal:
        return str(refusal)


@QUIET
@pytest.mark.parametrize("name", each(list(SMOOTHED), {"MarginalizedParticleFilter, one state", "JumpMarkovFilter"}))
def test_loaded_histories_go_on(name, tmp_path):
    filter = examples()[name]
    first = mo.run(0, filter, MODEL, YS[:4], keep=mo.keep.laws)
    loaded = mo.History.load(first.save(tmp_path / "h.npz"))
    ends = [mo.run(0, filter, MODEL, YS[4:], after=after) for after in (first, loaded)]
    np.testing.assert_array_equal(ends[0].mean, ends[1].mean)
    assert float(ends[0].log_likelihood) == float(ends[1].log_likelihood)
    for smoother in SMOOTHED[name]:
        means = [outcome(lambda h=h, s=smoother: mo.smooth(0, s, MODEL, h, ys=YS[:4]).mean) for h in (first, loaded)]
        np.testing.assert_array_equal(*means)


class Drive(NamedTuple):
    """Inputs in a class of the user's, its fields not in alphabetical order."""

    speed: object
    dt: object


@QUIET
def test_inputs_of_any_class_go_on(tmp_path):
    model = mo.StateSpaceModel(
        mo.Gaussian([0.0], [[1.0]]), mo.AdditiveGaussian(lambda x, u, t: x + u.speed * u.dt, [[0.1]]), mo.LinearGaussian([[1.0]], [[1.0]])
    )
    u, ys = Drive(np.arange(6.0), np.full(6, 0.5)), np.ones((6, 1))
    parts = [Drive(u.speed[piece], u.dt[piece]) for piece in (slice(4), slice(4, 6))]
    first = mo.run(0, mo.KalmanFilter(), model, ys[:4], parts[0])
    loaded = mo.History.load(first.save(tmp_path / "h.npz"))
    whole = mo.run(0, mo.KalmanFilter(), model, ys, u)
    np.testing.assert_array_equal(mo.run(0, mo.KalmanFilter(), model, ys[4:], parts[1], after=loaded).mean, whole.mean[4:])


def rewritten(path, change):
    """The same file with another header."""
    with zipfile.ZipFile(path) as old:
        members = {name: old.read(name) for name in old.namelist()}
    header = json.loads(members["header.json"])
    change(header["texts"])
    members["header.json"] = json.dumps(header).encode()
    with zipfile.ZipFile(path, "w") as new:
        for name, data in members.items():
            new.writestr(name, data)
    return path


def test_older_files_say_what_they_cannot(tmp_path):
    first = mo.run(0, mo.KalmanFilter(), MODEL, YS[:4], keep=mo.keep.laws)
    old = rewritten(first.save(tmp_path / "h.npz"), lambda texts: texts.pop("forms"))
    with pytest.warns(mo.MotesWarning, match="its laws are of a kind that files of this version do not name"):
        loaded = mo.History.load(old)
    whole = mo.run(0, mo.KalmanFilter(), MODEL, YS)
    np.testing.assert_array_equal(mo.run(0, mo.KalmanFilter(), MODEL, YS[4:], after=loaded).mean, whole.mean[4:])
    with pytest.raises(mo.MotesError, match="smooth history: expected a history whose laws are known, got one from a file that"):
        mo.smooth(0, mo.smoothers.RauchTungStriebelSmoother(), MODEL, loaded)
    with pytest.raises(mo.MotesError, match="run after: state: "):
        mo.run(0, mo.ParticleFilter(50), MODEL, YS[4:], after=loaded)


def test_another_filter_cannot_go_on():
    first = mo.run(0, mo.KalmanFilter(), MODEL, YS[:4])
    with pytest.raises(mo.MotesError, match="run after: expected the history of a run with the same filter and model, its state"):
        mo.run(0, mo.ParticleFilter(50), MODEL, YS[4:], after=first)
    with pytest.raises(mo.MotesError, match="run after: expected what mo.run gave, or History.load, got str"):
        mo.run(0, mo.KalmanFilter(), MODEL, YS[4:], after="h.npz")


@QUIET
def test_another_number_of_particles_cannot_go_on(tmp_path):
    first = mo.run(0, mo.ParticleFilter(40), MODEL, YS[:4])
    for before in (first, mo.History.load(first.save(tmp_path / "h.npz"))):
        with pytest.raises(mo.MotesError, match=r"the history of a run with 50 particles, as the filter has, got 40\. Go on with"):
            mo.run(0, mo.ParticleFilter(50), MODEL, YS[4:], after=before)


WRONG = {
    "another number of states": lambda texts: texts["names"].append("c"),
    "another law": lambda texts: texts["forms"]["state"].update(law="Cloud"),
    "no law": lambda texts: texts["forms"]["state"].update(law="Path"),
    "words for a form": lambda texts: texts["forms"].update(state="os.system"),
    "a part too many": lambda texts: texts["forms"]["state"]["parts"].update(center={"dict": {"x": "array"}}),
    "no names": lambda texts: texts.update(names=3),
    "forms of another kind": lambda texts: texts.update(forms=[1]),
}


@pytest.mark.parametrize("name", WRONG)
def test_headers_that_do_not_fit_are_refused(name, tmp_path):
    path = shaped(mo.KalmanFilter()).save(tmp_path / "h.npz")
    with pytest.raises(mo.FileError):
        mo.History.load(rewritten(path, WRONG[name]))


def test_arrays_that_do_not_fit_are_refused(tmp_path):
    good = shaped(mo.KalmanFilter())
    for change in (
        {"kept": {**good.kept, "mean": jnp.full((4, 2), jnp.nan)}},
        {"kept": {**good.kept, "mean": jnp.ones((5, 2))}},
        {"kept": {**good.kept, "mean": jnp.ones((4, 3))}},
        {"start": jnp.zeros((2, 2), jnp.int32)},
        {"kept": {"law": mo.Gaussian(jnp.zeros((3, 4)), jnp.zeros((3, 3, 4)))}},
    ):
        with pytest.raises(mo.FileError):
            mo.History.load(histories.replace(good, **change).save(tmp_path / "h.npz"))


def test_the_law_is_lost_without_its_name(tmp_path, monkeypatch):
    """The twin: laws that nobody names come back as dictionaries."""

    def none(tree):
        raise histories.UnspelledError

    monkeypatch.setattr(histories, "spelled", none)
    with pytest.warns(mo.MotesWarning, match="dictionaries"):
        assert isinstance(mo.History.load(shaped(mo.KalmanFilter()).save(tmp_path / "h.npz")).state, dict)
