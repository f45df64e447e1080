"""What a user's own files and settings may hold by mistake: one line says so, with the place and a cure, and nothing is written."""

import numpy as np
import pytest

from motes.cli.main import main
from motes.io.tables import read_table

# the command line ----------------------------------------------------------------------------------------------------

ROUTE = 41


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """A flight with its map and settings, as `motes demo` writes it."""
    from motes.applications.terrain.job import load
    from motes.cli.asked import Run, asked
    from motes.cli.demo import write

    folder = tmp_path_factory.mktemp("flight")
    wish = asked(Run, ["terrain", "--n", "50", "--route.fixes", str(ROUTE)], "motes demo terrain")
    write(folder / "terrain.toml", wish, load(wish.own(), 0))
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def folder(flight, tmp_path):
    for name, data in flight.items():
        (tmp_path / name).write_bytes(data)
    return tmp_path


def said(capsys, arguments, *words):
    """Assert exit code 2 and one line of at most 500 letters that holds the words; return it."""
    code = main([str(argument) for argument in arguments])
    lines = capsys.readouterr().err.strip().splitlines()
    assert code == 2 and len(lines) == 1, (code, lines)
    assert len(lines[0]) <= 500 and lines[0].isprintable()
    for word in words:
        assert word in lines[0], (word, lines[0])
    return lines[0]


def changed(folder, old, new):
    path = folder / "terrain.toml"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    return path


def rewritten(folder, change):
    """Change the cells of the table: a function of the names, and of rows of text."""
    lines = (folder / "flight.csv").read_text().splitlines()
    names, rows = lines[0].split(","), [line.split(",") for line in lines[1:]]
    change(names, rows)
    (folder / "flight.csv").write_text("\n".join([",".join(names), *(",".join(row) for row in rows)]) + "\n")
    return folder / "terrain.toml"


def cell(row, name, value):
    def change(names, rows):
        rows[row][names.index(name)] = value

    return change


def feet(*columns):
    def change(names, rows):
        for row in rows:
            for name in columns:
                row[names.index(name)] = f"{float(row[names.index(name)]) / 0.3048:.3f}"

    return change


@pytest.mark.parametrize("outside", ["refuse", "missing"])
@pytest.mark.parametrize(("name", "value"), [("height", "1e39"), ("ins_north", "1e39"), ("ins_altitude", "-1e39"), ("true_east", "1e39"),
                                             ("height", "-9999"), ("height", "-32768"), ("ins_altitude", "-9999"), ("height", "1e7")])
def test_numbers_that_cannot_be_are_named_with_file_and_line(folder, capsys, outside, name, value):
    changed(folder, 'outside = "refuse"', f'outside = "{outside}"')
    line = said(capsys, ["run", rewritten(folder, cell(3, name, value))], "flight.csv", repr(name), "line 5", "empty")
    assert ("missing = " in line) == (not name.startswith("ins"))
    assert not (folder / "run").exists()


@pytest.mark.parametrize(("row", "value", "words"), [
    (3, "0.3", ("line 5", "increase")), (3, "", ("line 5", "a time in every row")), (3, "0.6", ("line 5",)),
    (ROUTE - 1, "1e15", ("seconds",)), (0, "nan", ("line 2",))])
def test_times_name_the_file_and_the_line(folder, capsys, row, value, words):
    said(capsys, ["run", rewritten(folder, cell(row, "time", value))], "flight.csv", *words)


def test_times_of_parquet_name_the_file_and_the_row(folder, capsys):
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    columns = dict(read_table(folder / "flight.csv"))
    columns["time"][3] = 0.1
    parquet.write_table(arrow.table(columns), folder / "flight.parquet")
    said(capsys, ["run", changed(folder, '"flight.csv"', '"flight.parquet"')], "flight.parquet", "'time'", "row 4", "increase")


@pytest.mark.parametrize("columns", [("height",), ("ins_altitude",), ("height", "ins_altitude")])
def test_feet_are_told(folder, capsys, columns):
    said(capsys, ["run", rewritten(folder, feet(*columns))], "flight.csv",
         "altitude minus radar minus terrain", "3.28 times too large: feet?", "units = {", *map(repr, columns))


def test_meters_and_named_marks_of_missing_numbers_are_taken(flight, folder):
    from motes.applications.terrain import scenario
    from motes.applications.terrain.settings import MapFiles, Recording

    path = rewritten(folder, cell(3, "height", "-9999"))
    files = MapFiles(files=(str(path.parent / "jacksboro_fault_dem.npz"),))
    loaded = scenario.loaded(files, Recording(file=str(path.parent / "flight.csv"), missing=("-9999",)))
    assert np.isnan(np.asarray(loaded.ys)).ravel().nonzero()[0].tolist() == [3]


@pytest.mark.parametrize(("old", "new", "words"), [
    ('height = "height"', 'height = "ins_altitude"', ("'ins_altitude'", "two of them")),
    ('["ins_north", "ins_east", "ins_altitude"]', '["ins_north", "ins_north", "ins_altitude"]', ("'ins_north'",)),
    ('time = "time"', 'time = "height"', ("'height'",)),
    ('out = "run"', 'out = ""', ("out", "none")),
    ('out = "run"', 'out = "a\\u0000b"', ("out",)),
    ('out = "run"', 'out = "~nobody-of-that-name/x"', ("home folder",)),
    ('"flight.csv"', '"a\\u0000b"', ("a",)),
    ('["jacksboro_fault_dem.npz"]', '["a\\u0000b"]', ("a",)),
    ("seed = 0", "x" * 200_000 + " = 0", ("the keys", "'xxx", "...")),
    ("seed = 0", 'seed = "' + "x" * 200_000 + '"', ("a whole number",)),
    ("altimeter = 15.0", "altimeter = 1" + "0" * 400, ("altimeter", "a number")),
    ("altimeter = 15.0", "altimeter = " + "[" * 300 + "]" * 300, ("altimeter", "a number")),
    ("seed = 0", "a = " + "[" * 100_000, ("TOML",)),
])
def test_settings_that_cannot_be_are_refused(folder, capsys, old, new, words):
    before = {path.name for path in folder.iterdir()}
    said(capsys, ["run", changed(folder, old, new)], "motes run: ", *words)
    assert {path.name for path in folder.iterdir()} == before


def test_steps_of_time_that_cannot_be_are_refused(folder, capsys):
    said(capsys, ["run", folder / "terrain.toml", "--data.time", "", "--data.step", "1e15"], "data step", "1000000000000000")


def test_a_home_folder_is_one(folder, tmp_path, monkeypatch):
    from motes.cli.asked import Run, asked
    from motes.cli.options import from_flags
    from motes.cli.report import Report

    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    config = asked(Run, [str(changed(folder, 'out = "run"', 'out = "~/x"'))], "motes run").settings
    assert config.out == str(tmp_path / "home" / "x") and config.map.files == (str(folder / "jacksboro_fault_dem.npz"),)
    config = asked(Run, [str(folder / "terrain.toml"), "--out=~/y", "--data=~/z.csv"], "motes run").settings
    assert (config.out, config.data.file) == (str(tmp_path / "home" / "y"), str(tmp_path / "home" / "z.csv"))
    assert from_flags(Report(), ["--out=~/page.html"], "motes report").out == str(tmp_path / "home" / "page.html")


def test_the_full_path_is_said_before_anything_is_written(tmp_path, capsys, monkeypatch):
    from motes.cli.running import check_folder

    monkeypatch.chdir(tmp_path)
    for path in (str(tmp_path / "deep" / "x"), "deep/x", "./deep/../deep/x"):
        check_folder(path)
        assert str(tmp_path / "deep" / "x") in capsys.readouterr().out and not (tmp_path / "deep").exists()


@pytest.mark.parametrize("words", [["run"], ["plan"], ["report"], ["run", "--seed", "1"], ["report", "--out", "x"]])
def test_a_command_is_named_once(capsys, words):
    line = said(capsys, words, f"motes {words[0]}: ")
    assert line.count(f"motes {words[0]}") == 1
