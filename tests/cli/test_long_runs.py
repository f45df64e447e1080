"""Runs of the command that are killed go on where they were, with the same bits, and never from what another run kept."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import jax
import numpy as np
import pytest

import motes as mo
from motes.applications.interface import Job
from motes.cli import long_runs


def job_of(push=0.5, seed=0):
    """A model with functions made anew, and inputs."""
    model = mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.AdditiveGaussian(lambda x, u, t: push * x + u["step"], [[0.3]]),
                               mo.AdditiveGaussian(lambda x, u, t: x, [[0.2]]))  # fmt: skip
    inputs = {"step": np.linspace(0, 1, 41)[:, None].astype(np.float32)}
    return Job(model=model, ys=np.asarray(mo.simulate(seed, model, 41, inputs)[1]), inputs=inputs)


def started(job, folder, seed=1, n=30, keep=mo.keep.moments):
    return long_runs.whole_run(seed, mo.ParticleFilter(n=n), job, job.ys, job.inputs, keep, folder / "particle")


def leaves(history):
    return [np.asarray(leaf) for leaf in jax.tree.leaves((history.kept, history.info, history.last))]


def test_a_killed_run_goes_on_with_the_same_bits_and_no_other_does(tmp_path, monkeypatch):
    monkeypatch.setattr(long_runs, "EVERY", 0.0)
    whole = mo.filters.joined(list(started(job_of(), tmp_path / "whole")))
    cut = started(job_of(), tmp_path)
    for _ in range(5):
        next(cut)
    cut.close()
    for other in (started(job_of(0.6), tmp_path), started(job_of(seed=3), tmp_path), started(job_of(), tmp_path, seed=2),
                  started(job_of(), tmp_path, n=31), started(job_of(), tmp_path, keep=mo.keep.means)):  # fmt: skip
        assert len(next(other).ess) == 3, "another model, data, seed, filter, or other things kept"
        other.close()
    parts = list(started(job_of(), tmp_path))
    assert len(parts[0].ess) == 12 and len(parts) == 11
    again = mo.filters.joined(parts)
    assert all(np.array_equal(one, two) for one, two in zip(leaves(whole), leaves(again), strict=True))
    assert [len(part.ess) for part in started(job_of(), tmp_path)] == [41], "what is done is not done again"
    long_runs.forget()
    assert not list(tmp_path.glob(".*"))


def test_nothing_is_kept_where_a_run_cannot_be_told_apart_or_is_one_piece(tmp_path, monkeypatch):
    monkeypatch.setattr(long_runs, "EVERY", 0.0)

    def refuse(*args):
        raise mo.MotesError("not comparable")

    monkeypatch.setattr(long_runs, "fingerprint", refuse)
    assert len(list(started(job_of(), tmp_path))) == 14 and not list(tmp_path.glob(".*"))
    one = replace(job_of())
    assert len(list(started(job_of(), tmp_path, keep=lambda law: {"mean": law.mean()}))) == 14 and not list(tmp_path.glob(".*"))
    monkeypatch.setattr(Job, "goes_on", False)
    assert len(list(started(one, tmp_path))) == 14 and not list(tmp_path.glob(".*"))


def test_what_is_damaged_is_begun_anew_and_what_is_anothers_stays(tmp_path, monkeypatch):
    monkeypatch.setattr(long_runs, "EVERY", 0.0)
    (tmp_path / ".particle.0123456789abcdef.unfinished.npz").write_bytes(b"another's")
    cut = started(job_of(), tmp_path)
    next(cut), next(cut)
    cut.close()
    own = next(path for path in tmp_path.glob(".*") if "0123456789abcdef" not in path.name)
    own.write_bytes(own.read_bytes()[:100])
    with pytest.warns(mo.MotesWarning, match="The run is begun anew"):
        assert len(list(started(job_of(), tmp_path))) == 14
    long_runs.forget()
    assert [path.read_bytes() for path in tmp_path.glob(".*")] == [b"another's"]


def test_measurements_that_come_one_by_one_know_their_model(tmp_path, monkeypatch):
    """A user's own job says nothing of itself."""
    monkeypatch.setattr(long_runs, "EVERY", 0.0)

    class Frames:
        def __call__(self, step=0):
            return iter(np.zeros((2000, 1), np.float32)[step:])

        def __repr__(self):
            return "frames"

    def run(a):
        model = mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.LinearGaussian([[a]], [[0.3]]), mo.LinearGaussian([[1.0]], [[0.2]]))
        return long_runs.long_run(1, mo.KalmanFilter(), Job(model=model, ys=Frames()), mo.keep.moments, tmp_path / "kalman")

    cut = run(0.9)
    first = len(next(cut).ess)
    next(cut)
    cut.close()
    assert len(next(run(-0.9)).ess) == first, "another model begins anew"
    assert int(next(run(0.9)).start) == 0 and len(list(tmp_path.glob(".*"))) >= 1
    long_runs.forget()


@pytest.mark.night
def test_a_map_goes_on_after_a_kill(tmp_path):
    """The command itself, ended by SIGKILL as soon as it has kept something."""
    words = ["--seconds", "400", "--n", "50", "--seed", "1"]
    slow = ("import sys; from motes.cli import long_runs; long_runs.EVERY = 0.0; long_runs.CHUNKS = 60; "
            "from motes.cli.main import main; sys.exit(main(sys.argv[1:]))")  # fmt: skip

    def command(folder):
        return [sys.executable, "-c", slow, "demo", "slam", *words, "--out", str(tmp_path / folder)]

    subprocess.run(command("whole"), check=True, capture_output=True)
    killed = subprocess.Popen(command("cut"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    until = time.monotonic() + 300
    while not list((tmp_path / "cut").glob(f".*{long_runs.ENDING}")):
        assert killed.poll() is None and time.monotonic() < until
        time.sleep(0.02)
    os.kill(killed.pid, signal.SIGKILL)
    killed.wait()
    assert not (tmp_path / "cut" / "landmarks.npz").exists()
    subprocess.run(command("cut"), check=True, capture_output=True)
    whole, again = (mo.History.load(tmp_path / folder / "landmarks.npz") for folder in ("whole", "cut"))
    assert np.array_equal(whole.mean, again.mean) and np.array_equal(whole.cov, again.cov)
    assert float(whole.log_likelihood) == float(again.log_likelihood)
