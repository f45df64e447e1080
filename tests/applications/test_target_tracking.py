"""A radar that is blind to what flies across its line of sight: tracks begun among false plots and kept through the silence."""

import dataclasses
import io
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from data import refused
from motes.applications.target_tracking import scans as reading
from motes.applications.target_tracking.beginning import begun
from motes.applications.target_tracking.job import load
from motes.applications.target_tracking.model import Tracker
from motes.applications.target_tracking.settings import Radar, Settings
from motes.applications.target_tracking.shared import LOST
from motes.applications.target_tracking.world import SPEED, made_up
from motes.cli.main import main
from motes.io.dialect import TableFile
from motes.laws.observed import Observed
from motes.plotting.animation import Animation

pytestmark = pytest.mark.jax

RADAR, SCANS, PERIOD, ROOM = Radar(), 70, 2.0, 45
RUNS = 50


@pytest.fixture(scope="module")
def flights():
    return [made_up(seed, SCANS, PERIOD, RADAR) for seed in range(RUNS)]


def range_rates(world):
    return range_rates_of(world.states[:, 0].T)


def range_rates_of(states):
    """Of states on the axis before the last."""
    east, north, v_east, v_north = np.moveaxis(np.asarray(states)[..., :4, :], -2, 0)
    return (east * v_east + north * v_north) / np.hypot(east, north)


def tracked(flights, knows, n=2_000):
    """Errors of the position `(runs, t)` of a particle filter, NaN before the track begins."""
    begins = [begun(world.times, world.scans, RADAR) for world in flights]
    last = max(begin.scan for begin in begins)
    steps = SCANS - last
    model = Tracker(RADAR, ROOM, knows)(begins[0].mean, begins[0].cov).as_state_space()
    packed = []
    for world, begin in zip(flights, begins, strict=True):
        found = model.sensor.parts[0].packed(mo.plots([None, *world.scans[begin.scan + 1 : begin.scan + steps]]))
        packed.append((found.value, found.there, begin.mean, begin.cov))
    dt = jnp.full(steps, PERIOD)

    def one(row):
        key, value, there, mean, cov = row
        model = Tracker(RADAR, ROOM, knows)(mean, cov).as_state_space()
        filter = mo.ParticleFilter(n=n, on_collapse="predict")
        return mo.run(key, filter, model, Observed(value, there), {"dt": dt}, keep=mo.keep.means).mean[:, :2]

    stacked = (jnp.stack([jnp.asarray(part) for part in each]) for each in zip(*packed, strict=True))
    rows = (jax.random.split(jax.random.key(0), len(flights)), *stacked)
    means = np.asarray(jax.jit(lambda rows: jax.lax.map(one, rows))(rows))
    errors = np.full((len(flights), SCANS), np.nan)
    for found, mean, world, begin in zip(errors, means, flights, begins, strict=True):
        now = slice(begin.scan, begin.scan + steps)
        found[now] = np.hypot(*(mean - world.states[now, 0, :2]).T)
    return errors


@pytest.mark.night
def test_silence_tells_where_a_target_hides(flights):
    """A tracker that expects the same detection everywhere loses its target in a tenth of the flights at least."""
    hidden = np.array([np.abs(range_rates(world)) < RADAR.notch for world in flights])
    assert 12 < hidden.sum(axis=1).mean() < 20
    found = {}
    for knows in (True, False):
        errors = tracked(flights, knows)
        lost = int((np.nanmax(np.where(hidden, 0, errors), axis=1) > LOST).sum())
        found[knows] = lost, float(np.sqrt(np.nanmean(errors[hidden] ** 2)))
    assert found[True][0] <= 1
    assert found[True][1] <= 160
    assert found[False][1] > 2.5 * found[True][1]
    assert found[False][0] >= 5


def test_tracks_begin_at_the_target(flights):
    """Not at false plots: within four standard deviations of the true state."""
    for world in flights[:20]:
        begin = begun(world.times, world.scans, RADAR)
        off = begin.mean - world.states[begin.scan, 0]
        assert begin.scan < 8
        assert off @ np.linalg.solve(begin.cov, off) < 40
        assert np.hypot(*off[:2]) < 600


def test_flights_are_those_of_aircraft(flights):
    for world in flights:
        assert np.allclose(np.hypot(*world.states[:, 0, 2:].T), SPEED)
        steps = np.diff(world.states[:, 0, :2], axis=0)
        assert np.allclose(np.hypot(*steps.T), SPEED * PERIOD, rtol=0.02)


def test_silence_is_what_the_notch_explains():
    """One flight, and the pictures of it; the same flight by night is one of fifty."""
    job = load(Settings(scans=60), 3)
    job = dataclasses.replace(job, filters={"few": mo.ParticleFilter(n=1_000, on_collapse="predict")}, unaware=job.model)
    history = mo.run(0, job.filters["few"], job.model, job.ys, job.inputs, keep=job.keep)
    scores = {score.name: score.value for score in job.scores(history)}
    assert job.hidden.sum() > 8
    assert scores["while hidden"] < 350
    assert scores["worst"] < LOST
    rates = np.abs(range_rates_of(history.kept["cloud"][np.flatnonzero(job.hidden)[5:]]))
    assert np.mean(rates < RADAR.notch + 10) > 0.9, "particles wait in the notch"
    assert "while hidden, not lost" in job.verdict(history)
    pictures = job.pictures({"few": history})
    assert len(pictures["track.png"].axes) == 3
    file = io.BytesIO()
    Animation(pictures["track.gif"].draw, 2).savefig(file, dpi=40)
    assert file.getvalue()[:6] == b"GIF89a"


@pytest.mark.night
def test_the_demonstration_runs_again_from_its_files(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "notch", "--scans", "12", "--n", "100", "--seed", "2"]) == 0
    assert "plots each; the track begins at" in capsys.readouterr().out
    assert Path("out/track.gif").read_bytes()[:6] == b"GIF89a"
    assert main(["run", "out/target_tracking.toml", "--out", "again"]) == 0
    one, other = (np.asarray(mo.History.load(f"{folder}/particle.npz").mean) for folder in ("out", "again"))
    np.testing.assert_allclose(one, other, rtol=1e-4, atol=0.1)
    assert json.loads(Path("again/summary.json").read_text())["application"] == "target_tracking"


def write(path, rows, head="time,range,azimuth,range_rate"):
    path.write_text("\n".join([head, *rows]) + "\n")
    return str(path)


def test_scans_are_read_as_they_stand(tmp_path):
    """Azimuths are from north, clockwise; times of one scan are one; a row of a time alone, and a gap, are scans that saw nothing."""
    rows = ["0,1000,90,5", "0,2000,0,-5", "2,,,", "4,1500,180,1", "10,1500,270,1"]
    times, scans, _ = reading.read_scans(TableFile(file=write(tmp_path / "a.csv", rows)), 2.0)
    assert times.tolist() == [0, 2, 4, 6, 8, 10]
    assert [len(scan) for scan in scans] == [2, 0, 1, 0, 0, 1]
    np.testing.assert_allclose(scans[0], [[1000, 0, 5], [2000, np.pi / 2, -5]], atol=1e-12)
    np.testing.assert_allclose(np.abs(scans[5][0]), [1500, np.pi, 1], atol=1e-12)
    assert len(reading.read_scans(TableFile(file=str(tmp_path / "a.csv")), 0.0)[1]) == 4
    world = made_up(1, 12, 2.0, RADAR)
    reading.written_scans(tmp_path / "b.csv", world.times, world.scans)
    times, scans, _ = reading.read_scans(TableFile(file=str(tmp_path / "b.csv")), 0.0)
    np.testing.assert_allclose(times, world.times)
    for one, other in zip(scans, world.scans, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-4)


def test_seconds_are_believed_where_the_user_says_so(tmp_path):
    file = write(tmp_path / "a.csv", [f"{2000 * step},1000,0,1" for step in range(5)], "Zeit,range,azimuth,range_rate")
    with pytest.raises(mo.MotesError) as error:
        reading.read_scans(TableFile(file=file, columns={"time": "Zeit"}), 2.0)
    refused(error, "a.csv", "Milliseconds?")
    for name in ("time", "Zeit"):
        assert reading.read_scans(TableFile(file=file, columns={"time": "Zeit"}, units={name: "s"}), 2.0)[0][-1] == 8000


@pytest.mark.parametrize(("rows", "words"), [
    (["0,1000,90,5", "1,1000,,5"], ("column 'range'", "range, azimuth and range_rate, or none of them in line 3")),
    (["1,1000,90,5", "0,1000,90,5"], ("column 'time'", "line 3")),
    (["0,-3,90,5", "1,1000,90,5"], ("column 'range'", "meters, not below 0 in line 2", "-3")),
    (["0,1000,90,5", "1e9,1000,90,5"], ("column 'time'", "at most 10000 scans", "Set the period")),
    (["0,1000,90,5", "2,9000,10,5", "4,,,"], ("data", "3 of 5 scans with plots on a line", "none in 3 scans")),
])  # fmt: skip
def test_files_that_cannot_be_used_are_refused(rows, words, tmp_path):
    with pytest.raises(mo.MotesError) as error:
        load(Settings(data=TableFile(file=write(tmp_path / "a.csv", rows))), 0)
    refused(error, *words)


@pytest.mark.parametrize(("settings", "words"), [
    (Settings(scans=3), ("scans", "at least 10")),
    (Settings(period=0.0), ("period", "above 0")),
    (Settings(radar=Radar(detection=1.5)), ("radar detection", "at most 1")),
    (Settings(radar=Radar(azimuth=0.0)), ("radar azimuth", "above 0")),
])  # fmt: skip
def test_settings_that_cannot_be_are_refused(settings, words):
    with pytest.raises(mo.MotesError) as error:
        load(settings, 0)
    refused(error, *words)
