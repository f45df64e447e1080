"""Histories and checkpoints on disk: complete, checked, never pickled."""

import json
import zipfile

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo


@pytest.fixture
def history():
    model = mo.StateSpaceModel(mo.Gaussian([0.0, 1.0], np.eye(2)), mo.LinearGaussian(0.9 * np.eye(2), np.eye(2)),
                               mo.LinearGaussian(np.array([[1.0, 0.3]]), [[0.5]]), ("a", "b"))
    return mo.run(0, mo.MarginalizedParticleFilter(n=40, linear=("b",)), model, np.array([[1.0], [np.nan], [0.3]]), keep=mo.keep.laws)


def test_xarray_and_netcdf(history, tmp_path):
    xarray = pytest.importorskip("xarray")
    data = history.to_xarray()
    assert dict(data.sizes) == {"time": 3, "state": 2, "state2": 2} and list(data.state.values) == ["a", "b"]
    assert np.array_equal(data["mean"].sel(state="b"), history.mean[:, 1])
    again = xarray.load_dataset(history.save(tmp_path / "run.nc"), engine="h5netcdf")
    assert np.array_equal(again["cov"], history.cov) and float(again["log_likelihood"]) == float(history.log_likelihood)
    assert "MarginalizedParticleFilter" in again.attrs["filter"] and again.attrs["jax_version"]
    assert [path.name for path in tmp_path.iterdir()] == ["run.nc"]
    with pytest.raises(mo.FileError, match="expected a history saved as .npz, got a NetCDF file"):
        mo.History.load(tmp_path / "run.nc")


def test_numpy_file_brings_everything_back(history, tmp_path):
    again = mo.History.load(history.save(tmp_path / "run.npz"))
    assert np.array_equal(again.mean, history.mean) and np.array_equal(again.ess, history.ess)
    assert float(again.log_likelihood) == float(history.log_likelihood) and again.names == ("a", "b")
    assert np.array_equal(again.law.kalman.center, history.law.kalman.center)


def test_other_endings_and_folders_are_refused(history, tmp_path):
    with pytest.raises(mo.FileError, match="expected a name that ends in .nc or .npz, got .pkl"):
        history.save(tmp_path / "run.pkl")
    with pytest.raises(mo.FileError, match="expected a file that can be written"):
        history.save(tmp_path / "missing" / "run.npz")


def test_damage_is_refused_in_one_line(history, tmp_path):
    path = history.save(tmp_path / "run.npz")
    good = path.read_bytes()
    rng = np.random.default_rng(0)
    outcomes = {"refused": 0, "read": 0}
    for trial in range(150):
        bad = bytearray(good)
        if trial % 3 == 0:
            bad = bad[: rng.integers(0, len(bad))]
        else:
            for place in rng.integers(0, len(bad), 3):
                bad[place] ^= 1 << rng.integers(0, 8)
        path.write_bytes(bytes(bad))
        try:
            again = mo.History.load(path)
        except mo.FileError as error:
            outcomes["refused"] += 1
            assert str(path) in str(error) and "\n" not in str(error) and len(str(error)) <= 500
        else:
            outcomes["read"] += 1
            assert np.array_equal(again.mean, history.mean) and np.array_equal(again.cov, history.cov)
    assert outcomes["refused"] > 100


def test_other_kinds_and_formats_are_refused(history, tmp_path):
    path = history.save(tmp_path / "run.npz")
    with pytest.raises(mo.FileError, match="kind: expected checkpoint, got history"):
        mo.Stream.load(path, mo.ParticleFilter(n=3), None)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    members["header.json"] = json.dumps(json.loads(members["header.json"]) | {"format": 99}).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    with pytest.raises(mo.FileError, match="format: expected version 1, got version 99"):
        mo.History.load(path)
    with pytest.raises(mo.FileError, match="No such file"):
        mo.History.load(tmp_path / "nowhere.npz")


def test_checkpoint_of_another_filter_is_refused(tmp_path):
    model = mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.LinearGaussian([[0.9]], [[1.0]]), mo.LinearGaussian([[1.0]], [[0.5]]))
    stream = mo.stream(0, mo.ParticleFilter(n=30), model)
    stream.update([0.4])
    path = stream.save(tmp_path / "c.npz")
    with pytest.raises(mo.FileError, match="filter: expected ParticleFilter.*n=31.* got ParticleFilter.*n=30"):
        mo.Stream.load(path, mo.ParticleFilter(n=31), model)


def test_a_key_for_each_step():
    model = mo.StateSpaceModel(mo.Gaussian(jnp.zeros(1), jnp.eye(1)), mo.LinearGaussian(jnp.eye(1), jnp.eye(1)),
                               mo.LinearGaussian(jnp.eye(1), jnp.eye(1)))  # fmt: skip
    _, ys = mo.simulate(0, model, 6)
    keys = jax.random.split(jax.random.key(3), 6)
    one, other = (mo.run(given, mo.ParticleFilter(n=20), model, ys) for given in (keys, keys.at[4].set(jax.random.key(9))))
    assert np.array_equal(one.mean[:4], other.mean[:4]) and not np.array_equal(one.mean[4], other.mean[4])
    with pytest.raises(mo.MotesError, match=r"run key: expected shape \(6,\) \(one for each step\), got shape \(5,\)"):
        mo.run(keys[:5], mo.ParticleFilter(n=20), model, ys)
