"""The command line as somebody meets it who has files of his own: what one would guess works, what is wrong is told with its cure."""

import csv
from datetime import datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from test_cli import refused

import motes as mo
from motes.cli.main import main

FIXES = 31
NAMES = {"time": "Zeit", "ins_north": "Nord", "ins_east": "Ost", "ins_altitude": "Höhe", "height": "Radarhöhe"}
SUMMER = datetime(2024, 7, 31, 23, 59, 55, tzinfo=ZoneInfo("Europe/Berlin"))
TERRAIN = """application = "terrain"
out = "found"

[map]
files = ["jacksboro_fault_dem.npz"]

[data]
file = "own.csv"
%s

[filter]
kind = "particle"
n = 100
"""
OWN = """separator = ";"
decimal = ","
missing = [-9999, "n.a."]
inertial = ["Nord", "Ost", { column = "Höhe", unit = "ft" }]
height = { column = "Radarhöhe", unit = "ft" }
time = { column = "Zeit", format = "day first", zone = "Europe/Berlin" }"""


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A flight, and what a run of it finds."""
    folder = tmp_path_factory.mktemp("flown")
    with pytest.MonkeyPatch.context() as surroundings:
        surroundings.setenv("XDG_CACHE_HOME", str(folder / "cache"))
        words = ["--route.fixes", str(FIXES), "--filter", "particle", "--filter.n", "100", "--out", str(folder / "out")]
        assert main(["demo", "terrain", *words]) == 0
        yield folder / "out"


@pytest.fixture
def folder(flown, tmp_path, monkeypatch):
    """A folder with the map, in which the user stands, and the rows of the flight."""
    monkeypatch.chdir(tmp_path)
    Path("jacksboro_fault_dem.npz").write_bytes((flown / "jacksboro_fault_dem.npz").read_bytes())
    return list(csv.DictReader((flown / "flight.csv").read_text().splitlines()))


def told(path, separator=","):
    return list(csv.DictReader(Path(path).read_text().splitlines(), delimiter=separator))


def spelled(row, number, feet=("ins_altitude", "height")):
    """A row as a German logger writes it: feet, commas, local times, -9999 where the altimeter failed."""
    cells = {name: float(row[name]) / (0.3048 if name in feet else 1) for name in list(NAMES)[1:]}
    moment = SUMMER + timedelta(seconds=float(row["time"]))
    texts = [f"{moment:%d.%m.%Y %H:%M:%S},{moment.microsecond // 1000:03d}"]
    texts += [f"{value:.3f}".replace(".", ",") for value in cells.values()]
    return ";".join([*texts[:-1], "-9999" if number == 4 else "n.a." if number == 7 else texts[-1]])


def own_file(rows, **how):
    lines = [";".join(NAMES.values()), *(spelled(row, number, **how) for number, row in enumerate(rows))]
    Path("own.csv").write_text("# Logger 7\n" + "\n".join(lines) + "\n", encoding="utf-8")


def test_feet_commas_local_days_and_codes_by_a_file_that_one_would_guess(folder, flown, capsys):
    own_file(folder)
    Path("own.toml").write_text(TERRAIN % OWN)
    assert main(["run", "own.toml"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[-1].startswith("particle: ") and "trusted" in said[-1]
    mean, usual = (mo.History.load(path / "particle.npz").mean for path in (Path("found"), flown))
    # two fixes are missing, so that it differs a little
    assert np.abs(np.asarray(mean)[:4] - np.asarray(usual)[:4]).max() < 1e-1 * np.abs(usual).max()
    track, before = told("found/track.csv", ";"), told(flown / "track.csv")
    assert list(track[0]) == ["time", "Nord", "Ost", "Höhe", "sd north, m", "sd east, m", "sd altitude, m", "flags"]
    assert track[0]["time"] == "31.07.2024 23:59:55,000000" and track[20]["time"].startswith("01.08.2024 00:00:01")
    assert float(track[2]["Höhe"].replace(",", ".")) * 0.3048 == pytest.approx(float(before[2]["ins_altitude"]), abs=5)
    assert len(track) == FIXES and [float(row["time"]) for row in before[:3]] == pytest.approx([0.0, 0.3, 0.6])


def test_dates_are_dates_in_netcdf(folder, flown):
    xarray = pytest.importorskip("xarray")
    own_file(folder)
    Path("own.toml").write_text(TERRAIN % OWN)
    assert main(["run", "own.toml", "--seed", "1"]) == 0
    with xarray.open_dataset("found/particle.nc", engine="h5netcdf") as data:
        assert data.time.dtype.kind == "M"
        assert data.time.values[0] == np.datetime64("2024-07-31T21:59:55") and data.time.values[-1] > data.time.values[0]
    with xarray.open_dataset(flown / "particle.nc", engine="h5netcdf") as data:
        np.testing.assert_allclose(data.time.values, 0.3 * np.arange(FIXES), atol=1e-6)


WRONG = [
    (OWN.replace('unit = "ft"', 'unit = "foots"', 1), ("units Höhe", "'foots'", "'ft'")),
    (OWN.replace('unit = "ft"', 'unit = "kn"', 1), ("units Höhe", "a unit of length", "'kn', one of speed")),
    (OWN.replace('zone = "Europe/Berlin"', 'zone = "Berlin"'), ("time_zone", "'Europe/Berlin'")),
    (OWN.replace('format = "day first", ', ""), ("line 3", "'Zeit'", 'Set time_format = "day first"')),
    (OWN.replace('decimal = ","', ""), ("line 3", "'Nord'", 'decimal = ","')),
    (OWN.replace("-9999, ", ""), ("column 'Radarhöhe'", "meters between -500", "missing = [-9999]")),
    (OWN.replace('"n.a."', '"lost"'), ("line 10", "'n.a.'", 'missing = ["n.a."]')),
    (OWN.replace("decimal", "dezimal"), ("'dezimal'", "Perhaps 'decimal' is meant.")),
    (OWN.replace("column =", "colum =", 1), ("inertial", "'colum'", "Perhaps 'column' is meant.")),
    (OWN.replace('"Radarhöhe"', '"Radar"'), ("own.csv: expected a column 'Radar'", 'Perhaps, under [data]: height = "Radarhöhe"')),
    (OWN.replace('separator = ";"', 'separator = "semi"'), ("separator", "one character", "'semi'")),
    (OWN.replace('{ column = "Radarhöhe", unit = "ft" }', '"Radarhöhe"'),
     ("altitude minus radar minus terrain", "'Radarhöhe' is 3.28 times too large: feet?",
      'units = { "Höhe" = "ft", "Radarhöhe" = "ft" }')),
]  # fmt: skip


@pytest.mark.parametrize(("text", "words"), WRONG, ids=range(len(WRONG)))
def test_what_is_wrong_in_it_is_told_with_its_cure(folder, capsys, text, words):
    own_file(folder)
    Path("own.toml").write_text(TERRAIN % text)
    refused(capsys, ["run", "own.toml"], *words)
    assert not Path("found").exists()


def test_columns_that_are_not_named_are_proposed_and_the_proposal_runs(folder, capsys):
    own_file(folder)
    Path("own.toml").write_text(TERRAIN % 'decimal = ","\nmissing = [-9999, "n.a."]\ntime_format = "day first"')
    assert main(["run", "own.toml"]) == 2
    line, *proposal = capsys.readouterr().err.strip().splitlines()
    assert "expected a column" in line and line.endswith("Perhaps, in the TOML file:")
    assert proposal == ["[data]", 'file = "own.csv"', 'inertial = ["Nord", "Ost", "Höhe"]', 'height = "Radarhöhe"', 'time = "Zeit"']
    more = "\n".join(['decimal = ","', 'missing = [-9999, "n.a."]', 'time_format = "day first"', *proposal[2:]])
    Path("own.toml").write_text(TERRAIN % more)
    refused(capsys, ["run", "own.toml"], "3.28 times too large: feet?", units := 'units = { "Höhe" = "ft", "Radarhöhe" = "ft" }')
    Path("own.toml").write_text(TERRAIN % f"{more}\n{units}")
    assert main(["run", "own.toml"]) == 0


def test_flags_say_the_same(folder, capsys):
    own_file(folder)
    words = ["--map.files", "jacksboro_fault_dem.npz", "--data", "own.csv", "--data.decimal", ",", "--data.missing", "-9999", "n.a.",
             "--data.inertial", "Nord", "Ost", "Höhe", "--data.height", "Radarhöhe", "--data.time", "Zeit",
             "--data.time_format", "day first",
             "--data.units", "Höhe", "ft", "--data.units.Radarhöhe", "ft", "--filter", "particle", "--filter.n", "100"]  # fmt: skip
    assert main(["run", "terrain", *words]) == 0
    assert Path("out/track.csv").is_file()
    capsys.readouterr()
    refused(capsys, ["run", "terrain", *words, "--data.units.Radarhöhe"], "--data.units.Radarhöhe", "nothing")
    refused(capsys, ["run", "terrain", *words, "--data.decimall", ","], "--data.decimall", "Perhaps --data.decimal is meant.")


def test_milliseconds_signs_and_another_datum_are_told(folder, capsys):
    def written(change):
        rows = [{name: float(row[name]) for name in NAMES} for row in folder]
        lines = [",".join(NAMES), *(",".join(f"{value:.3f}".removesuffix(".000") for value in change(row).values()) for row in rows)]
        Path("own.csv").write_text("\n".join(lines) + "\n")
        Path("own.toml").write_text(TERRAIN % "")
        return "own.toml"

    for change, words in (
        (lambda row: row | {"time": 1e3 * row["time"]}, ("times in seconds", "Milliseconds?", 'units = { time = "ms" }')),
        (lambda row: row | {"height": -row["height"]}, ("'height'", "positive numbers")),
        (lambda row: row | {"ins_altitude": row["height"], "height": row["ins_altitude"]}, ("are exchanged?", "inertial = [")),
        (lambda row: row | {"ins_altitude": row["ins_altitude"] + 900}, ("another zero", "vertical_position = ")),
        (lambda row: row | {"ins_altitude": row["ins_altitude"] / 0.3048}, ("'ins_altitude' is 3.28 times too large: feet?",)),
    ):
        refused(capsys, ["run", written(change)], "own.csv", *words)


# plots and reports ---------------------------------------------------------------------------------------------------


def plots(units):
    """Scans of an aircraft that flies straight, in units of one's own."""
    times = np.arange(0.0, 40.0, 2.0)
    east, north = 20e3 - 180.0 * times, 9e3 + 40.0 * times
    distance, azimuth = np.hypot(east, north), np.degrees(np.arctan2(east, north)) % 360
    rate = (-180.0 * east + 40.0 * north) / distance
    own = {"km": 1e-3, "nmi": 1 / 1852, "ft": 1 / 0.3048, "kn": 3600 / 1852, "km/h": 3.6, "rad": np.pi / 180, "ms": 1e3}
    columns = {"time": times, "range": distance, "azimuth": azimuth, "range_rate": rate}
    columns = {name: own.get(units.get(name), 1.0) * column for name, column in columns.items()}
    rows = [",".join(f"{value:.9g}" for value in row) for row in zip(*columns.values(), strict=True)]
    if "azimuth" in units:
        # false plots from all around tell it
        draw = np.random.default_rng(0)
        false = [(time, draw.uniform(1e3, 6e4), draw.uniform(0, 2 * np.pi), draw.uniform(-300, 300)) for time in times for _ in range(4)]
        rows = sorted([*rows, *(",".join(f"{value:.9g}" for value in row) for row in false)], key=lambda row: float(row.split(",")[0]))
    Path("plots.csv").write_text("\n".join([",".join(columns), *rows]) + "\n")


@pytest.mark.parametrize("units", [{"azimuth": "rad"}, {"range": "km"}, {"range": "nmi", "range_rate": "kn"}, {"range_rate": "kn"},
                                   {"time": "ms"}])  # fmt: skip
def test_units_of_plots_are_told_and_taken(tmp_path, monkeypatch, capsys, units):
    from motes.applications.target_tracking.job import load
    from motes.applications.target_tracking.settings import Settings
    from motes.io.dialect import TableFile

    monkeypatch.chdir(tmp_path)
    plots(units)
    Path("wrong.toml").write_text('application = "target_tracking"\n[data]\nfile = "plots.csv"\nunits = { rnge = "km" }\n')
    refused(capsys, ["run", "wrong.toml"], "units", "'rnge'", "Perhaps 'range' is meant.")
    line = "units = { " + ", ".join(f'{name} = "{unit}"' for name, unit in units.items()) + " }"
    refused(capsys, ["run", "target_tracking", "--data", "plots.csv"], "plots.csv", line)
    assert load(Settings(data=TableFile(file="plots.csv", units=units)), 0).times[-1] == 38.0


def test_columns_of_plots_are_proposed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    # the animation takes ten seconds to draw, elsewhere
    monkeypatch.setattr("motes.applications.target_tracking.one.TrackingJob.pictures", lambda job, histories: {})
    plots({"range": "km"})
    text = Path("plots.csv").read_text().partition("\n")[2]
    Path("plots.csv").write_text("Zeit,Entfernung [km],Azimut,Doppler\n" + text)
    assert main(["run", "target_tracking", "--data", "plots.csv"]) == 2
    said = capsys.readouterr().err
    line = 'columns = { time = "Zeit", range = { column = "Entfernung [km]", unit = "km" }, azimuth = "Azimut", range_rate = "Doppler" }'
    assert line in said and "expected a column 'time'" in said
    filter = '[filter]\nkind = "particle"\nn = 200\n'
    Path("own.toml").write_text(f'application = "target_tracking"\n[data]\nfile = "plots.csv"\n{line}\n{filter}')
    assert main(["run", "own.toml"]) == 0
    rows = told("out/track.csv")
    assert list(rows[0])[:3] == ["time", "range", "azimuth"] and 10 < float(rows[0]["range"]) < 30
    assert {path.name for path in Path("out").iterdir()} >= {"track.csv", "particle.nc"}


@pytest.mark.parametrize(("change", "words"), [
    ({"groundspeed": 1852 / 3600}, ("groundspeed", 'units = { groundspeed = "m/s" }')),
    ({"groundspeed": 1.852}, ('units = { groundspeed = "km/h" }',)),
    ({"track": np.pi / 180}, ("Radians?", 'units = { track = "rad" }')),
    ({"latitude": np.pi / 180, "longitude": np.pi / 180}, ('units = { latitude = "rad", longitude = "rad" }',)),
    ({"timestamp": 1e3}, ('units = { timestamp = "ms" }',)),
])  # fmt: skip
def test_units_of_reports_are_told(tmp_path, monkeypatch, capsys, change, words):
    from motes.applications.aircraft.world import flown_reports

    monkeypatch.chdir(tmp_path)
    reports = flown_reports(0, 300.0)
    columns = {name: column * change.get(name, 1.0) for name, column in reports._asdict().items()}
    rows = [",".join(f"{value:.12g}" for value in row) for row in zip(*columns.values(), strict=True)]
    Path("adsb.csv").write_text("\n".join([",".join(columns), *rows]) + "\n")
    refused(capsys, ["run", "aircraft", "--data", "adsb.csv"], "adsb.csv", *words)


@pytest.mark.parametrize(("change", "line"), [
    ({"range": 1 / 0.3048}, 'range = "ft"'), ({"forward": 100.0}, 'forward = "cm"'), ({"turn": 180 / np.pi}, 'turn = "deg"')])
def test_units_of_a_robots_recording_are_told_and_taken(tmp_path, change, line):
    from motes.applications.robot.bag import read_recording
    from motes.applications.robot.settings import Topics
    from motes.applications.robot.world import simulated
    from motes.io.recordings import write_plaza

    recording = simulated(1, 90.0)
    odometry, ranges = recording.odometry.copy(), recording.ranges.copy()
    odometry[:, 1] *= change.get("forward", 1.0)
    odometry[:, 2] *= change.get("turn", 1.0)
    ranges[:, 2] *= change.get("range", 1.0)
    write_plaza(tmp_path / "own.mat", mo.replace(recording, odometry=odometry, ranges=ranges))
    with pytest.raises(mo.MotesError) as error:
        read_recording(tmp_path / "own.mat", Topics(), {})
    assert f"above all tables: units = {{ {line} }}" in str(error.value)
    name, unit = line.replace('"', "").split(" = ")
    found = read_recording(tmp_path / "own.mat", Topics(), {name: unit})
    np.testing.assert_allclose(found.odometry, recording.odometry, atol=1e-9)
    np.testing.assert_allclose(found.ranges, recording.ranges, atol=1e-9)


# a model of one's own ------------------------------------------------------------------------------------------------

MODEL = '''"""My model."""

import math

import jax.numpy as jnp

import motes as mo


def made(sensor):
    walk = mo.LinearGaussian(jnp.eye(2), 0.1 * jnp.eye(2))
    return mo.StateSpaceModel(mo.Gaussian(jnp.zeros(2), jnp.eye(2)), walk, mo.AdditiveGaussian(sensor, jnp.eye(1)), ("east", "north"))


def good():
    return made(lambda x, u, t: jnp.hypot(x[0], x[1])[None])


def hypotenuse(x, u, t):
    return jnp.array([math.hypot(x[0], x[1])])


def branch(x, u, t):
    if x[0] > 0:
        return x[:1]
    return x[1:]


def with_math():
    return made(hypotenuse)


def with_if():
    return made(branch)
'''


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """A folder with a model and its measurements, in which the user stands."""
    monkeypatch.chdir(tmp_path)
    Path("walk_model.py").write_text(MODEL)
    rows = [f"{datetime(2024, 1, 31, 12) + timedelta(seconds=step):%m/%d/%Y %H:%M:%S} {1000 * (1 + step):.1f}" for step in range(5)]
    Path("y.txt").write_text("% made by hand\nday clock dist\n" + "\n".join(rows) + "\n")
    return tmp_path


@pytest.mark.parametrize("word", ["walk_model.py:good", "walk_model:good"])
def test_a_model_in_a_file_or_a_module_runs_with_units(mine, capsys, word):
    Path("own.toml").write_text(f'''application = "{word}"
[data]
file = "y.txt"
separator = "spaces"
comment = "%"
columns = [{{ column = "dist", unit = "mm" }}]
[filter]
kind = "extended kalman"
''')
    assert main(["run", "own.toml"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[-2] == "Results are in out." and said[-1].startswith("extended_kalman: ")
    rows = told("out/track.csv")
    assert list(rows[0]) == ["step", "east", "north", "sd east", "sd north", "flags"] and len(rows) == 5


def test_times_of_ones_own_model_come_back_as_they_were(mine):
    rows = [f"{30 + number}/01/2024 12:00;{1 + number},5" for number in range(2)]
    Path("y.csv").write_text("t;a\n" + "\n".join(rows) + "\n")
    words = ["--data", "y.csv", "--data.decimal", ",", "--data.time", "t", "--data.time_format", "day first", "--filter", "extended kalman"]
    assert main(["run", "walk_model.py:good", *words]) == 0
    assert [row["time"] for row in told("out/track.csv", ";")] == ["30/01/2024 12:00", "31/01/2024 12:00"]


@pytest.mark.parametrize(("word", "words"), [
    ("with_math", ("walk_model.py, line 20", "Write jnp.hypot for math.hypot.")),
    ("with_if", ("walk_model.py, line 24", "if x[0] > 0:", "write jnp.where(condition, a, b) for `if`"))])
@pytest.mark.parametrize("place", ["walk_model.py", "walk_model"])
def test_what_jax_cannot_trace_points_into_the_users_file(mine, capsys, word, words, place):
    more = ["--data", "y.txt", "--data.comment", "%", "--data.columns", "dist", "--filter", "extended kalman"]
    refused(capsys, ["run", f"{place}:{word}", *more], "motes run: sensor f(x, u, t)", *words)


def test_no_word_of_the_command_comes_twice(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for command in ("run", "plan", "study", "report", "completion"):
        assert main([command]) == 2
        assert capsys.readouterr().err.startswith(f"motes {command}: arguments: expected ")
    refused(capsys, ["rnu"], "'rnu'", "Perhaps 'run' is meant.")
    refused(capsys, ["demo", "terain"], "Perhaps 'terrain' is meant.")
    refused(capsys, ["run", "aircrft"], "Perhaps 'aircraft' is meant.")


def test_shells_are_told_what_to_complete(capsys):
    of_bash = ("_motes()", "--noises.altimeter", 'watch) words="--rate')
    for shell, words in {"bash": of_bash, "zsh": ("bashcompinit",), "fish": ("complete -c motes",)}.items():
        assert main(["completion", shell]) == 0
        said = capsys.readouterr().out
        for word in ("terrain", "notch", "calibrate", *words):
            assert word in said
    refused(capsys, ["completion", "bsh"], "'bsh'", "Perhaps 'bash'")
