"""An airliner tracked by radar plots drawn from its recorded flight: smoother, model, and the trackers side by side over 20 seeds."""

import gzip
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from data import recorded, refused
from motes.applications.aircraft import scenario
from motes.applications.aircraft.model import Flight, Radar, constant_velocity, jumping, turned, white_acceleration

pytestmark = pytest.mark.jax

SEEDS, STEPS = 20, 1660


def test_the_smoother_gives_the_moments_of_one_large_gaussian():
    """Positions and speeds of a random walk in acceleration, as one linear system solved at once; no residual is an outlier."""
    rng = np.random.default_rng(0)
    times = np.cumsum(np.r_[0.0, rng.integers(1, 4, 11)])
    position, speed = 100 * times + rng.normal(0, 30, 12), 100 + rng.normal(0, 2, 12)
    rows, values = [], []

    def equation(weights, at, value, root):
        row = np.zeros((len(root), 36))
        for (i, block) in zip(at, weights, strict=True):
            row[:, 3 * i : 3 * i + 3] = block
        rows.append(np.linalg.solve(root, row)), values.append(np.linalg.solve(root, value))

    equation([np.eye(3)], [0], np.array([position[0], speed[0], 0]), np.diag([50.0, 2.0, 1.0]))
    for i in range(12):
        equation([np.eye(3)[:2]], [i], np.array([position[i], speed[i]]), np.diag([50.0, 2.0]))
        if i:
            dt = times[i] - times[i - 1]
            F = np.array([[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]])
            inner = [[dt**5 / 20, dt**4 / 8, dt**3 / 6], [dt**4 / 8, dt**3 / 3, dt**2 / 2], [dt**3 / 6, dt**2 / 2, dt]]
            equation([np.eye(3), -F], [i, i - 1], np.zeros(3), np.linalg.cholesky(inner))
    wanted = np.linalg.lstsq(np.concatenate(rows), np.concatenate(values), rcond=None)[0].reshape(12, 3)
    assert np.allclose(scenario.smoothed(times, position, speed), wanted, rtol=1e-6, atol=1e-6)
    late = position.copy()
    late[6] -= 3000.0
    assert np.abs(scenario.smoothed(times, late, speed) - wanted)[:, 0].max() < 150


def test_a_coordinated_turn_is_a_circle(double):
    x = jnp.array([100.0, -50.0, 80.0, 60.0, 0.03])
    steps = np.asarray(turned(x, jnp.asarray(7.0)))
    half = jnp.append(turned(x, jnp.asarray(3.5)), 0.03)
    assert np.allclose(turned(half, jnp.asarray(3.5)), steps, rtol=1e-12)
    center = np.array([100.0 - 60.0 / 0.03, -50.0 + 80.0 / 0.03])
    assert np.allclose(np.hypot(*(steps[:2] - center)), 100 / 0.03, rtol=1e-12)
    for rate in (0.0, 1e-9, 1.4e-4, 1.5e-4):
        straight = x.at[4].set(rate)
        slope = jax.jacfwd(lambda x: turned(x, jnp.asarray(7.0)))(straight)
        assert np.isfinite(slope).all() and np.allclose(slope[:2, 4], [-49 / 2 * 60, 49 / 2 * 80], rtol=1e-2)
    assert np.allclose(white_acceleration(2.0, 3.0)[1], [0, 18, 0, 9])


@pytest.fixture(scope="module")
def flights():
    path = scenario.read_path(recorded("aircraft/adsb/belevingsvlucht.csv"))
    tracks = [scenario.track(path, seed, STEPS, Radar()) for seed in range(SEEDS)]
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *tracks)


def flown(filter, build, flights):
    """Scores and numbers of collapses over all seeds."""

    def one(key, track):
        history = mo.run(key, filter, build(track.start), track.ys, track.dt, keep=mo.keep.means)
        return scenario.score(history.mean, track), jnp.sum(history.info.collapsed)

    keys = jax.random.split(jax.random.key(0), SEEDS)
    return jax.tree.map(np.asarray, jax.jit(jax.vmap(one))(keys, flights))


@pytest.mark.night
@pytest.mark.optimized  # much to compute
def test_particles_with_modes_beat_constant_velocity_and_equal_interacting_models(flights):
    """Mean position at most 43 m and velocity at most 8.2 m/s with 200 particles, no track lost, in 20 seeds."""
    assert np.all(np.asarray(flights.scored).sum(axis=1) > 1350)
    jump, _ = flown(mo.JumpMarkovFilter(n=200, sampled=("turn",)), lambda start: jumping(start, Flight(), Radar()), flights)
    mixed, _ = flown(mo.InteractingMultipleModel(), lambda start: jumping(start, Flight(), Radar()), flights)
    assert jump.position.mean() < 43 and jump.velocity.mean() < 8.2 and jump.worst.max() < scenario.LOST
    assert jump.position.mean() < mixed.position.mean() + 0.5 and jump.velocity.mean() < mixed.velocity.mean() + 0.1
    for intensity in (10.0, 30.0):
        plain, _ = flown(mo.ExtendedKalmanFilter(), lambda start, q=intensity: constant_velocity(start, q, Radar()), flights)
        assert np.all(jump.position < plain.position) and np.all(jump.velocity < plain.velocity)


@pytest.mark.night
def test_a_particle_filter_of_constant_velocity_is_lost_and_says_so(flights):
    """With q = 5 m^2/s^3 the first turn loses it in every seed, and from then on no particle explains the plots."""
    few = jax.tree.map(lambda leaf: leaf[:3], flights)
    filter = mo.ParticleFilter(n=1000, on_collapse="predict")

    def one(key, track):
        history = mo.run(key, filter, constant_velocity(track.start, 5.0, Radar()), track.ys, track.dt, keep=mo.keep.means)
        return scenario.score(history.mean, track), history.info.collapsed

    lost, collapsed = jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(0), 3), few)
    assert np.all(np.asarray(lost.worst) > scenario.LOST) and np.all(np.asarray(collapsed).sum(axis=1) > 100)


# other people's recordings -------------------------------------------------------------------------------------------

COLUMNS = ["timestamp", "latitude", "longitude", "groundspeed", "track"]


def made_up(count=900, seed=3):
    """Reports of a flight in racetracks at 5 s: seconds, degrees, knots, degrees from north."""
    t = 1.7e9 + 5.0 * np.arange(count)
    course = np.degrees(np.cumsum(np.where(np.arange(count) % 120 < 24, 0.13, 0.0)))
    speed = np.full(count, 240.0)
    north, east = (np.cumsum(5 * scenario.KNOT * speed * part(np.radians(course))) for part in (np.cos, np.sin))
    jitter = np.random.default_rng(seed).normal(0, 15, (2, count))
    latitude = 48 + np.degrees((north + jitter[0]) / scenario.EARTH)
    longitude = 11 + np.degrees((east + jitter[1]) / scenario.EARTH / np.cos(np.radians(48)))
    return dict(zip(COLUMNS, (t, latitude, longitude, speed, course % 360), strict=True))


def in_csv(folder, reports, name="flight.csv"):
    cells = ([("" if np.isnan(value) else repr(float(value))) for value in row] for row in zip(*reports.values(), strict=True))
    lines = [",".join(reports), *map(",".join, cells)]
    (folder / name).write_text("\n".join(lines) + "\n")
    return folder / name


def in_json(folder, reports, milliseconds=True):
    scaled = {name: [None if np.isnan(value) else float(value) for value in values] for name, values in reports.items()}
    if milliseconds:
        scaled["timestamp"] = [1000 * value for value in scaled["timestamp"]]
    rows = [dict(zip(scaled, row, strict=True)) for row in zip(*scaled.values(), strict=True)]
    (folder / "flight.json.gz").write_bytes(gzip.compress(json.dumps(rows).encode()))
    return folder / "flight.json.gz"


ALL = {"start": 0.0, "duration": 1e5, "radar": (-30e3, 10e3)}


def test_paths_are_the_same_in_all_forms_of_file(tmp_path):
    reports = made_up()
    table = scenario.read_path(in_csv(tmp_path, reports), **ALL)
    for other in (in_json(tmp_path, reports), in_json(tmp_path, reports, milliseconds=False)):
        for one, two in zip(table[:2], scenario.read_path(other, **ALL)[:2], strict=True):
            np.testing.assert_allclose(one, two, atol=1e-5)
    silent = {name: values.copy() for name, values in reports.items()}
    for names in (("latitude", "longitude"), ("groundspeed", "track")):
        for name in names:
            silent[name][100:103] = np.nan
    assert len(scenario.read_path(in_csv(tmp_path, silent), **ALL).times) == len(table.times) - 3
    whole, part = table, scenario.read_path(tmp_path / "flight.csv", 1000.0, 600.0, (-30e3, 10e3))
    assert len(whole.times) == 897 + 3 and part.times[-1] == 600 and np.hypot(*np.median(part.states[:, :2], axis=0)) < 60e3


def test_a_recorded_flight_is_the_same_in_json():
    table, packed = (scenario.read_path(recorded(f"aircraft/adsb/belevingsvlucht.{form}")) for form in ("csv", "json.gz"))
    np.testing.assert_allclose(table.states, packed.states, atol=1e-6)


@pytest.mark.parametrize(("change", "settings", "words"), [
    ({}, {}, ("second 556", "start and duration")),
    ({"latitude": np.nan}, ALL, ("'latitude'", "line 12", "none")),
    ({"track": np.nan}, ALL, ("'track'", "line 12", "none")),
    ({"timestamp": np.nan}, ALL, ("'timestamp'", "line 12")),
    ({"timestamp": 1.0}, ALL, ("'timestamp'", "line 12", "never decrease")),
    ({"latitude": 480.0}, ALL, ("'latitude'", "480")),
    ({"groundspeed": -9999.0}, ALL, ("'groundspeed'", "-9999")),
    ({}, ALL | {"start": 1e4}, ("positions from second 10000",)),
    ({}, ALL | {"duration": 0.0}, ("duration",)),
    ({}, ALL | {"start": np.nan}, ("start",)),
    ({}, ALL | {"radar": (np.inf, 0.0)}, ("radar east",)),
])
def test_recordings_that_cannot_be_flown_are_refused(tmp_path, change, settings, words):
    reports = made_up(60)
    for name, value in change.items():
        reports[name][10] = value
    with pytest.raises(mo.MotesError) as error:
        scenario.read_path(in_csv(tmp_path, reports), **settings)
    refused(error, *words)


def test_of_several_aircraft_one_is_named(tmp_path):
    """Rows of several flights may lie among one another; each is smoothed as if it were alone."""
    one, other = made_up(40), mirrored(made_up(40, 4))
    rows = [(*values, name) for name, reports in (("4b1", one), ("39e2", other)) for values in zip(*reports.values(), strict=True)]
    lines = [",".join([*COLUMNS, "icao24"]), *(",".join(map(str, row)) for row in sorted(rows))]
    (tmp_path / "both.csv").write_text("\n".join(lines) + "\n")
    for name, reports in (("4b1", one), ("39e2", other)):
        alone = scenario.read_path(in_csv(tmp_path, reports), **ALL)
        np.testing.assert_allclose(scenario.read_path(tmp_path / "both.csv", **ALL, aircraft=name).states, alone.states)
    both = scenario.read_paths(tmp_path / "both.csv", 20.0, 100.0)
    assert list(both) == ["39e2", "4b1"]
    assert both["4b1"].times[[0, -1]].tolist() == [0, 100]
    place = (both["4b1"].states[0, :2] + scenario.RADAR) / scenario.EARTH
    expected = one["latitude"][4] - np.median(np.r_[one["latitude"][4:25], other["latitude"][4:25]])
    assert abs(np.degrees(place[1]) - expected) < 3e-3
    for aircraft, words in (("", ("39e2, 4b1", "got none", "motes run target_tracking")), ("4b", ("39e2, 4b1", "'4b'"))):
        with pytest.raises(mo.MotesError) as error:
            scenario.read_path(tmp_path / "both.csv", **ALL, aircraft=aircraft)
        refused(error, "aircraft", *words)
    with pytest.raises(mo.MotesError) as error:
        scenario.read_path(in_csv(tmp_path, one), **ALL, aircraft="4b1")
    refused(error, "aircraft", "no column icao24")
    with pytest.raises(mo.MotesError) as error:
        scenario.read_paths(tmp_path / "both.csv", 1e4)
    refused(error, "both.csv", "an aircraft with 10 positions from second 10000")


def test_a_path_without_a_scored_plot_is_refused(tmp_path):
    path = scenario.read_path(in_csv(tmp_path, made_up(12)), **ALL)
    with pytest.raises(mo.MotesError) as error:
        scenario.track(path._replace(times=path.times[:5], states=path.states[:5]), 0, 50, Radar())
    refused(error, "track path", "20 s")


def mirrored(reports):
    return reports | {"longitude": -reports["longitude"], "track": -reports["track"] % 360}


SECOND = {
    "first": lambda reports: reports,
    "mirrored": mirrored,
    "beyond the date line": lambda reports: reports | {"longitude": (reports["longitude"] - 11 + 180 + 180) % 360 - 180},
    "cut": lambda reports: {name: values[200:] for name, values in reports.items()},
    "resampled": lambda reports: {name: values[::2] for name, values in reports.items()},
    "with outliers": lambda reports: reports | {"latitude": reports["latitude"] + 0.02 * (np.arange(900) % 97 == 50)},
}


@pytest.mark.optimized  # much to compute
@pytest.mark.night
def test_second_recordings_are_as_good_as_the_first(tmp_path):
    """The tracker's error on flights that were recorded in other ways, all in one program."""
    paths = [scenario.read_path(in_csv(tmp_path, change(made_up())), **ALL) for change in SECOND.values()]
    tracks = [scenario.track(path, 0, 700, Radar()) for path in paths]
    flights = jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *tracks)
    filter = mo.JumpMarkovFilter(n=200, sampled=("turn",))

    def one(key, track):
        history = mo.run(key, filter, jumping(track.start, Flight(), Radar()), track.ys, track.dt, keep=mo.keep.means)
        return scenario.score(history.mean, track)

    found = jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(0), len(paths)), flights)
    assert np.all(np.asarray(found.worst) < 400) and np.all(np.asarray(found.position) < 60)


# false plots among those of the aircraft ------------------------------------------------------------------------------

CLUTTERED = Radar(detection=0.8, false=20.0)


def test_scans_hold_the_aircrafts_plots_among_false_ones():
    path = scenario.path_of(scenario.Reports(*made_up().values()))
    found = scenario.track(path, 1, 300, CLUTTERED)
    alone = scenario.track(path, 1, 300, Radar(detection=0.8))
    own, there = np.asarray(alone.ys), np.asarray(found.ys.there)
    seen = ~np.isnan(own).any(axis=1)
    assert not there[0]
    assert there[seen].all()
    assert 0.02 < 1 - there.mean() < 0.1
    counts = (~np.isnan(np.asarray(found.ys.value))).all(axis=2).sum(axis=1)
    assert counts[~there].max() == 0
    assert abs(counts[there].mean() - 20.8) < 1.5
    near = np.isclose(np.asarray(found.ys.value)[..., 0], own[:, :1]).any(axis=1)
    np.testing.assert_array_equal(near, seen)


@pytest.mark.night
@pytest.mark.optimized  # much to compute
@pytest.mark.parametrize(("file", "begin", "duration", "steps"), [("belevingsvlucht.csv", 556.0, 4800.0, 1600),
                                                                  ("noisy_landing.json.gz", 0.0, 4800.0, 260)])  # fmt: skip
def test_flights_are_kept_among_twenty_false_plots(file, begin, duration, steps):
    """Detection 0.8: none of 20 runs lost, hardly less accurate than without false plots.

    With 200 particles one run in 20 is 1 066 m off at one plot, after a turn that two scans in a row did not see, and back at the next.
    """
    path = scenario.read_path(recorded(f"aircraft/adsb/{file}"), begin, duration)
    tracks = [scenario.track(path, seed, steps, CLUTTERED) for seed in range(SEEDS)]

    def one(row):
        key, track = row
        filter = mo.JumpMarkovFilter(n=400, sampled=("turn",))
        history = mo.run(key, filter, jumping(track.start, Flight(), CLUTTERED), track.ys, track.dt, keep=mo.keep.means)
        return scenario.score(history.mean, track)

    rows = (jax.random.split(jax.random.key(0), SEEDS), jax.tree.map(lambda *leaves: jnp.stack(list(map(jnp.asarray, leaves))), *tracks))
    found = jax.tree.map(np.asarray, jax.jit(lambda rows: jax.lax.map(one, rows))(rows))
    assert found.worst.max() < scenario.LOST
    assert found.position.mean() < 46 and found.velocity.mean() < 8.5
