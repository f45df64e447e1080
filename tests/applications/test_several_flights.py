"""Tracks of an unknown, changing number of targets: probability of existence, beginning and end, files of several flights."""

import io
import itertools
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from data import recorded, refused
from motes.applications.aircraft import scenario
from motes.applications.aircraft.reports import REPORT
from motes.applications.target_tracking import scans as reading
from motes.applications.target_tracking import tracks as managed
from motes.applications.target_tracking.beginning import Beginning, beginnings
from motes.applications.target_tracking.job import load
from motes.applications.target_tracking.settings import Radar, Settings
from motes.applications.target_tracking.several import SeveralJob
from motes.applications.target_tracking.world import World, made_up, range_rate, seen
from motes.cli.main import main
from motes.io.dialect import TableFile
from motes.laws.observed import Observed

pytestmark = pytest.mark.jax

RADAR, PERIOD = Radar(), 2.0


# existence -----------------------------------------------------------------------------------------------------------

DETECTION, CLUTTER, DT = 0.7, 0.02, 30.0
SCANS = [[[0.5, -0.4], [3.0, 1.0]], [], [[0.2, 0.9]], [[-1.0, 0.4], [0.1, 0.3], [2.0, -2.0]]]


def log_density(plot, variance):
    return -np.sum(np.square(plot)) / (2 * variance) - np.log(2 * np.pi * variance)


def by_enumeration(scans, variance):
    """Sum over all times at which the target goes away and all plots, or none, that are its own before; it stands at the origin."""
    stays, found = np.exp(-DT / managed.STAYS), []
    for last in range(1, len(scans) + 1):
        weights = {True: 0.0, False: (1 - managed.BEGINS)}
        for end in range(last + 1):
            chance = managed.BEGINS * stays**end * (1 - stays if end < last else 1)
            for own in itertools.product(*([None, *range(len(scan))] for scan in scans[:end])):
                part = chance
                for scan, plot in zip(scans, own, strict=False):
                    part *= 1 - DETECTION if plot is None else DETECTION * np.exp(log_density(scan[plot], variance)) / CLUTTER
                weights[end == last] += part
        found.append(weights[True] / sum(weights.values()))
    return found


class Still:
    """Makes the model of a target that stands still."""

    sensor = mo.Cluttered(mo.LinearGaussian(jnp.eye(2, 4), jnp.eye(2)), DETECTION, clutter=CLUTTER, plots=3)

    def __call__(self, mean, cov):
        still = mo.LinearGaussian(jnp.eye(4), 1e-12 * jnp.eye(4))
        return mo.StateSpaceModel(mo.Gaussian(mean, cov), still, self.sensor, ("e", "n", "ve", "vn"))


@pytest.mark.parametrize(("spread", "scans"), [(0.0, SCANS), (1.5, SCANS[:1])])
def test_existence_is_exact_where_the_filter_is(double, spread, scans):
    """Of a target that stands still at a known place; of one at an unknown place at the first scan, before plots are mixed."""
    ys = Still.sensor.packed(mo.plots([np.reshape(scan, (-1, 2)) for scan in scans]))
    steps = [Observed(jnp.asarray(value), jnp.asarray(there)) for value, there in zip(ys.value, ys.there, strict=True)]
    follower = managed.Follower(jax.random.key(0), mo.ExtendedKalmanFilter(), Still(), steps[0])
    tracks = follower.begun(follower.none(), Beginning(0, np.zeros(4), (spread**2 + 1e-12) * np.eye(4)), 0)
    found = []
    for y in steps:
        tracks, _ = follower.advanced(tracks, y, DT)
        found.append(tracks.exists[0])
    np.testing.assert_allclose(found, by_enumeration(scans, 1 + spread**2), rtol=1e-6)
    nothing = Observed(jnp.full((3, 2), jnp.nan), jnp.asarray(False))
    assert np.isclose(follower.advanced(tracks, nothing, DT)[0].exists[0], found[-1] * np.exp(-DT / managed.STAYS)), "no scan tells nothing"


def in_slots(means, spread=100.0, exists=1.0, numbers=None):
    """Tracks at some states."""
    count = len(means)
    numbers, cov = np.arange(count) if numbers is None else np.array(numbers), np.broadcast_to(spread**2 * np.eye(4), (count, 4, 4))
    return managed.Tracks(numbers, np.zeros(count, bool), None, np.broadcast_to(exists, count), np.array(means, float), cov)


def test_of_two_tracks_of_one_target_the_older_stays():
    means = [[0, 0, 100, 0], [150, 0, 120, 0], [0, 0, -500, 0], [600, 0, 100, 0]]
    assert managed.merged(in_slots(means, numbers=[5, 3, 4, 2])).number.tolist() == [-1, 3, 4, 2]
    assert managed.merged(in_slots(means, numbers=[3, 5, 4, -1])).number.tolist() == [3, -1, 4, -1]
    # a track between two that it would be one with, which are not one themselves
    chain = [[0, 0, 0, 0], [250, 0, 0, 0], [500, 0, 0, 0]]
    assert managed.merged(in_slots(chain)).number.tolist() == [0, -1, 2]


def test_tracks_are_confirmed_for_good_and_end():
    tracks = in_slots(np.diag([1e6] * 4), exists=[0.995, 0.5, 0.005, np.nan])
    tracks = managed.confirmed(managed.ended(tracks))
    assert tracks.number.tolist() == [0, 1, -1, -1]
    assert tracks.confirmed.tolist() == [True, False, False, False]
    assert managed.confirmed(tracks._replace(exists=np.full(4, 0.2))).confirmed.tolist() == [True, False, False, False]


def test_plots_near_a_track_begin_none():
    """Near in place and in range rate; of three in a row that no track explains one begins."""
    flight = np.stack([20e3 + 200.0 * PERIOD * np.arange(4), np.full(4, 9e3), np.full(4, 200.0), np.zeros(4)], axis=1)
    plots = np.stack([np.hypot(*flight[:, :2].T), np.arctan2(flight[:, 1], flight[:, 0]), range_rate(flight)], axis=1)
    scans = [plots[step, None] for step in (0, 1, 3)]
    times = PERIOD * np.array([0, 1, 3])
    begin, = beginnings(times, scans, RADAR)
    assert begin.scan == 2
    assert np.abs(begin.mean - flight[3]).max() < 1
    assert beginnings(times, [*scans[:2], plots[3, None] + [0, 0, 90.0]], RADAR) == []
    assert len(beginnings(times, [np.concatenate([scan, scan * [1, -1, 1]]) for scan in scans], RADAR)) == 2
    track = in_slots(flight[3:])
    assert managed.unexplained(track, plots[3:], RADAR).size == 0
    assert len(managed.unexplained(track, plots[3:] + [0, 0, 900.0], RADAR)) == 1
    assert len(managed.unexplained(track, plots[3:] + [900.0, 0, 0], RADAR)) == 1


# several flights -----------------------------------------------------------------------------------------------------

LENGTH = 60


def straight(begin, velocity, first, last):
    """States `(t, 4)` of a flight from one scan to another, NaN elsewhere."""
    steps = np.arange(LENGTH)[:, None]
    states = np.concatenate([begin + PERIOD * (steps - first) * np.array(velocity), np.broadcast_to(velocity, (LENGTH, 2))], axis=1)
    return np.where((steps >= first) & (steps < last), states, np.nan)


FLIGHTS = {
    "comes and goes": straight([-30e3, -10e3], [150.0, 60.0], 6, 34),
    "crosses": straight([10e3, 26e3], [120.0, -160.0], 0, LENGTH),
    "is crossed": straight([22e3, 26e3], [-80.0, -160.0], 0, LENGTH),
    # across the line of sight, where its range rate is in the notch for 20 scans
    "hides": straight([12e3, -22e3], [-200.0, 0.0], 10, LENGTH),
}  # fmt: skip


def job_of(folder, states, names, seed=1):
    """The job of files of some flights and the plots of them."""
    world = World(PERIOD * np.arange(len(states)), names, states, seen(np.random.default_rng(seed), states, RADAR))
    reading.written_scans(folder / "plots.csv", world.times, world.scans)
    reading.written_truth(folder / "truth.csv", world)
    return load(Settings(data=TableFile(file=str(folder / "plots.csv")), truth=str(folder / "truth.csv"), period=0.0), 0)


def ran(job):
    ys = job.tracker.sensor.packed(job.ys)
    return next(iter(job.pieces(0, job.filters["jump_markov"], ys, job.inputs, job.keep, 5)))


@pytest.fixture(scope="module")
def run_of_four(tmp_path_factory):
    job = job_of(tmp_path_factory.mktemp("four"), np.stack(list(FLIGHTS.values()), axis=1), tuple(FLIGHTS))
    return job, ran(job)


def test_targets_that_come_and_go_are_found_and_let_go(run_of_four):
    """Among ten false plots a scan: each has its track within eight scans and to its end, and no other track is confirmed."""
    job, history = run_of_four
    judged = job.judged(history)
    assert job.targets == tuple(FLIGHTS)
    scores = {score.name: score.value for score in job.scores(history)}
    assert scores["false tracks"] == 0 and scores["swaps"] == 0 and scores["tracks"] == 4
    assert scores["position"] < 150 and scores["tracked"] > 85
    for there, tracks in zip(judged.there.T, judged.followers.T, strict=True):
        first = np.flatnonzero(there)[0]
        assert (tracks[first + 8:][there[first + 8:]] >= 0).all()
    track = judged.followers[30, 0]
    alive = np.flatnonzero(history.kept["confirmed"][:, track])
    assert 33 <= alive[-1] <= 40, "it ends some scans after its target"


def test_a_target_in_the_notch_still_exists(run_of_four):
    """Its existence falls far more slowly there than that of a target that should be seen."""
    job, history = run_of_four
    judged = job.judged(history)
    hidden = np.flatnonzero(np.abs(range_rate(FLIGHTS["hides"])) < RADAR.notch - 2 * RADAR.edge)
    exists = history.kept["exists"][:, judged.followers[-1, 3]]
    assert len(hidden) > 8
    assert exists[hidden].min() > 0.15
    gone = history.kept["exists"][34:, judged.followers[30, 0]]
    assert gone[5] < 0.15


def test_the_crossing_is_one(run_of_four):
    apart = np.hypot(*(FLIGHTS["crosses"] - FLIGHTS["is crossed"])[:, :2].T)
    assert apart.min() < 300, "nearer than the radar can tell by places"
    job, history = run_of_four
    assert [row[6] for row in job.by_target(history).rows] == [0, 0, 0, 0]


def test_a_target_that_gives_two_plots_keeps_one_track(tmp_path):
    """Two tracks begin, since each has a plot, and are found to be one."""
    states, generator = FLIGHTS["crosses"][:30, None], np.random.default_rng(0)
    both = [seen(generator, states, Radar(false=1e-6, detection=0.99)) for _ in range(2)]
    scans = [np.concatenate(pair) for pair in zip(*both, strict=True)]
    reading.written_scans(tmp_path / "plots.csv", PERIOD * np.arange(30), scans)
    history = ran(load(Settings(data=TableFile(file=str(tmp_path / "plots.csv")), targets=0), 0))
    counts = (history.kept["exists"] > 0).sum(axis=1)
    assert counts.shape == (30,) and (counts[2:] == 1).all()


def test_tracks_are_written_and_drawn(run_of_four, tmp_path):
    job, history = run_of_four
    tables = job.tables(history)
    rows = np.loadtxt(io.StringIO(tables["tracks"].to_csv()), delimiter=",", skiprows=1)
    assert tables["tracks"].columns == ("time", "track", "east", "north", "v_east", "v_north", "exists")
    assert len(rows) == history.kept["confirmed"].sum() and set(rows[:, 1]) == {1, 2, 3, 4}
    assert rows[:, 6].max() <= 1 and rows[:, 0].max() == PERIOD * (LENGTH - 1)
    assert "comes and goes" in job.verdict(history)
    assert len(job.pictures({"any": history})["tracks.png"].axes) == 3
    again = mo.History.load(history.save(tmp_path / "a.npz"))
    np.testing.assert_allclose(again.kept["states"], history.kept["states"], rtol=1e-6)
    with pytest.raises(mo.MotesError) as error:
        next(iter(job.pieces(0, job.filters["jump_markov"], job.ys, job.inputs, mo.keep.laws, 5)))
    refused(error, "smoother", "none where several targets are followed")


def test_room_doubles_when_it_is_full(run_of_four):
    job, _ = run_of_four
    ys = job.tracker.sensor.packed(job.ys)
    y = Observed(jnp.asarray(ys.value[0]), jnp.asarray(ys.there[0]))
    follower = managed.Follower(jax.random.key(0), mo.InteractingMultipleModel(), job.tracker, y)
    tracks = follower.none()
    for number in range(managed.SLOTS + 1):
        tracks = follower.begun(tracks, Beginning(0, np.full(4, float(number)), np.eye(4)), number)
    assert tracks.number.tolist() == [*range(managed.SLOTS + 1), *[-1] * (managed.SLOTS - 1)]
    assert tracks.mean[:, 0].tolist()[: managed.SLOTS + 1] == list(range(managed.SLOTS + 1))
    assert tracks.carries.step.shape == (2 * managed.SLOTS,)


# files ---------------------------------------------------------------------------------------------------------------


def test_true_states_are_told_apart_by_target(tmp_path):
    rows = ["0,0,0,1,0,a", "0,9,0,1,0,007", "2,2,0,1,0,a", "1,10,0,1,0,007"]
    (tmp_path / "t.csv").write_text("\n".join(["time,east,north,v_east,v_north,target", *rows]) + "\n")
    names, states = reading.read_truth(Settings(truth=str(tmp_path / "t.csv")), np.array([0.0, 1.0, 2.0]))
    assert names == ("a", "007")
    np.testing.assert_array_equal(states[..., 0], [[0, 9], [1, 10], [2, np.nan]])
    assert made_up(3, 20, PERIOD, RADAR).names == ("1",)
    assert made_up(3, 20, PERIOD, RADAR, 0).states.shape == (20, 0, 4)


@pytest.mark.parametrize(("rows", "words"), [
    (["0,0,0,1,0,a", "1,0,0,1,0,"], ("a name or a number in line 3 (row 2), column 'target'", "none")),
    (["0,0,0,1,0,a", "5,0,0,1,0,b", "0,1,0,1,0,a"], ("column 'time'", "line 4 (row 3)", "times that increase")),
])  # fmt: skip
def test_true_states_that_cannot_be_used_are_refused(rows, words, tmp_path):
    (tmp_path / "t.csv").write_text("\n".join(["time,east,north,v_east,v_north,target", *rows]) + "\n")
    with pytest.raises(mo.MotesError) as error:
        reading.read_truth(Settings(truth=str(tmp_path / "t.csv")), np.zeros(2))
    refused(error, "t.csv", *words)


@pytest.mark.parametrize("start", [b"\x30\x00\x30\xfd", b"\x22\x00\x0b\xf0", b"\xd4\xc3\xb2\xa1", b"\x0a\x0d\x0d\x0a"])
def test_plots_as_radars_send_them_are_refused(start, tmp_path):
    (tmp_path / "plots.ast").write_bytes(start + bytes(range(60)))
    with pytest.raises(mo.MotesError) as error:
        load(Settings(data=TableFile(file=str(tmp_path / "plots.ast"))), 0)
    refused(error, "plots.ast", "ASTERIX", "pip install asterix_decoder", "time (s), range (m", "range_rate (m/s)")


def reports(folder):
    """A recording of two aircraft, one of which is within reach of the radar from its 60th second on."""
    rows = []
    for name, east, speed in (("4b1", -78e3, 300.0), ("39e2", 10e3, -100.0)):
        for second in range(0, 301, 5):
            place = np.degrees((east + speed * second) / scenario.EARTH / np.cos(np.radians(50)))
            course = 90 if speed > 0 else 270
            rows.append((second, 50 + 1e-7 * second, 8 + place, abs(speed) / scenario.KNOT, course, name))
    lines = ["timestamp,latitude,longitude,groundspeed,track,icao24", *(",".join(map(str, row)) for row in sorted(rows))]
    (folder / "adsb.csv").write_text("\n".join(lines) + "\n")
    return str(folder / "adsb.csv")


def test_plots_are_drawn_along_a_recording(tmp_path):
    file, radar = reports(tmp_path), Radar(false=1e-3)
    middle = np.median([-78e3 + 300 * np.arange(0, 101, 5), 10e3 - 100 * np.arange(0, 101, 5)])
    settings = Settings(data=TableFile(file=file), scans=50, site=Settings().site.__class__(-middle, 0.0), radar=radar)
    job = load(settings, 0)
    assert isinstance(job, SeveralJob)
    assert job.targets == ("4b1", "39e2")
    truth = job.truth
    there = ~np.isnan(truth).any(axis=2)
    np.testing.assert_allclose(truth[:, 1, 0], 10e3 - 100 * job.times, atol=60)
    assert there[:, 1].all()
    assert abs(job.times[there[:, 0]][0] - 60) <= PERIOD
    first = [plots for plots in job.world.scans if len(plots)][0]
    assert len(first) == 1 and abs(first[0, 0] - 10e3) < 800 and abs(first[0, 2] + 100) < 10
    with pytest.raises(mo.MotesError) as error:
        load(Settings(data=TableFile(file=file), radar=Radar(farthest=10.0)), 0)
    refused(error, "site", "within 10 m of a flight", "2 flights further off")


# by night ------------------------------------------------------------------------------------------------------------


@pytest.mark.night
def test_several_flights_into_the_notch_are_kept():
    """Three in each of 20 worlds: all confirmed, no false track, at most one lost in the notch."""
    totals = []
    for seed in range(20):
        job = load(Settings(targets=3), seed)
        history = ran(job)
        scores = {score.name: score.value for score in job.scores(history)}
        judged = job.judged(history)
        assert (judged.followers >= 0).any(axis=0).all()
        totals.append((scores["false tracks"], scores["swaps"], scores["tracked"], scores["position"]))
    false, swaps, tracked, position = np.array(totals, float).T
    assert false.sum() == 0 and swaps.sum() <= 1
    assert tracked.mean() > 92 and position.mean() < 100


@pytest.mark.night
def test_the_demonstration_of_several_runs_again_from_its_files(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "notch", "--targets", "3", "--scans", "20", "--seed", "2"]) == 0
    assert "confirmed after, s" in capsys.readouterr().out
    assert main(["run", "out/target_tracking.toml", "--out", "again"]) == 0
    one, other = (mo.History.load(f"{folder}/jump_markov.npz").kept["states"] for folder in ("out", "again"))
    np.testing.assert_allclose(one, other, rtol=1e-4, atol=0.1)
    assert Path("again/jump_markov_tracks.csv").read_text().startswith("time,track,east,north,v_east,v_north,exists")
    assert json.loads(Path("again/summary.json").read_text())["results"]["jump_markov"]["false_tracks"] == 0


@pytest.mark.night
def test_recorded_flights_are_followed_at_once(tmp_path):
    """Three recordings as if flown at one time and place; plots of a radar among them."""
    lines = ["timestamp,latitude,longitude,groundspeed,track,icao24"]
    for name in ("belevingsvlucht", "alto_adige", "munich"):
        table = mo.io.read_table(recorded(f"aircraft/adsb/{name}.json.gz"), REPORT)
        time, *rest = (table[column] for column in REPORT)
        seconds = (time - time[0]) / 1e3
        rest[0], rest[1] = rest[0] - np.nanmedian(rest[0]) + 50, rest[1] - np.nanmedian(rest[1]) + 8
        rows = zip(seconds, *rest, strict=True)
        lines += [",".join([*("" if np.isnan(cell) else repr(float(cell)) for cell in row), name]) for row in rows]
    (tmp_path / "adsb.csv").write_text("\n".join(lines) + "\n")
    job = load(Settings(data=TableFile(file=str(tmp_path / "adsb.csv")), scans=600, radar=Radar(farthest=150e3)), 0)
    history = ran(job)
    scores = {score.name: score.value for score in job.scores(history)}
    print(scores, job.verdict(history))
    assert scores["false tracks"] == 0
