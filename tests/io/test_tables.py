import contextlib

import numpy as np
import pytest

from data import recorded, refused
from motes.core.checks import FileError, MotesError
from motes.io.arrays import read_arrays
from motes.io.dialect import Dialect
from motes.io.tables import column_names, read_table, times

arrow = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")


def file(folder, content, name="table.csv"):
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder / name


def packed(folder, columns, **options):
    parquet.write_table(arrow.table(columns), folder / "table.parquet", write_page_checksum=True, **options)
    return folder / "table.parquet"


# good files ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "a,b\n1,2.5\n,-3e2\n",
        "a;b\r\n1;2.5\r\n;-3e2\r\n",
        "a\tb\n1\t2.5\n\t-3e2",
        "\ufeffa,b\n1,2.5\nNaN,-3e2\n\n\n",
        '"a","b"\n"1","2.5"\n"","-300"\n',
        " a , b \n 1 , 2.5 \n NA , -300 \n",
        "a,b\r1,2.5\r,-300\r",
    ],
)
def test_forms_of_csv(tmp_path, text):
    table = read_table(file(tmp_path, text, "any.name"))
    assert list(table) == ["a", "b"]
    np.testing.assert_array_equal(table["a"], [1, np.nan])
    np.testing.assert_array_equal(table["b"], [2.5, -300])
    assert table["a"].dtype == np.float64


def test_chosen_columns_come_in_the_order_asked(tmp_path):
    path = file(tmp_path, 'name,"x, y",z\n"two\nlines, quoted",1,2\nother,3,4\n')
    table = read_table(path, ["z", "x, y"])
    assert list(table) == ["z", "x, y"] and table["x, y"].tolist() == [1, 3]


def test_columns_of_text_are_read_where_they_are(tmp_path):
    """Labels stay what they are, also those that look like numbers; rows are taken apart by them."""
    csv = file(tmp_path, "a,who\n1, 4e1\n2,b c\n3,4e1\n")
    json = file(tmp_path, '[{"a": 1, "who": "4e1"}, {"a": 2, "who": "b c"}, {"a": 3, "who": "4e1"}]', "table.json")
    for path in (csv, json, packed(tmp_path, {"a": [1.0, 2.0, 3.0], "who": ["4e1", "b c", "4e1"]})):
        assert column_names(path) == ["a", "who"]
        parts = read_table(path, ["a"], ["who", "where"]).by("who")
        assert {name: part["a"].tolist() for name, part in parts.items()} == {"4e1": [1, 3], "b c": [2]}
        assert "3" in parts["4e1"].place(1)
        assert list(read_table(path, ["a"]).by("who")) == [""]
    with pytest.raises(FileError) as error:
        read_table(file(tmp_path, "a,who\n1,x\n2,\n"), ["a"], ["who"]).by("who")
    refused(error, "a name or a number in line 3 (row 2)", "column 'who'", "none")


def test_times_become_unix_seconds(tmp_path):
    text = "t,u\n2018-05-30T15:21:38.250000Z,2018-05-30\n2018-05-30T17:21:39+02:00,\n2018-05-30 15:21:40,2018-05-31\n"
    table = read_table(file(tmp_path, text))
    np.testing.assert_array_equal(table["t"], [1527693698.25, 1527693699.0, 1527693700.0])
    np.testing.assert_array_equal(table["u"], [1527638400.0, np.nan, 1527724800.0])


def test_recorded_flight_is_the_same_in_both_forms():
    columns = ["timestamp", "latitude", "altitude", "track"]
    text = read_table(recorded("aircraft/adsb/belevingsvlucht.csv"), columns)
    binary = read_table(recorded("aircraft/adsb/belevingsvlucht.parquet"), columns)
    assert list(text) == list(binary) == columns and len(text["altitude"]) == 16005
    for name in columns:
        np.testing.assert_array_equal(text[name], binary[name])


@pytest.mark.parametrize("name", ["nile", "lynx", "coal", "galaxies"])
def test_recorded_series(name):
    assert all(np.isfinite(column).all() for column in read_table(recorded(f"timeseries/{name}.csv")).values())


def test_types_of_parquet(tmp_path):
    micro = [1_700_000_000_000_001, None, 1_700_000_000_010_001]
    columns = {
        "whole": arrow.array([1, None, 3], arrow.int16()),
        "real": arrow.array([1.5, np.nan, None], arrow.float32()),
        "decimal": arrow.array([1, 2, 3], arrow.decimal128(5, 2)),
        "utc": arrow.array(micro, arrow.timestamp("us", tz="UTC")),
        "local": arrow.array([10**18, 0, -500_000_000], arrow.timestamp("ns")),
        "day": arrow.array([1, 2, None], arrow.date32()),
        "text": arrow.array(["1", "", "2.5"]),
        "iso": arrow.array(["1970-01-02", None, "1970-01-01T00:00:01Z"]).dictionary_encode(),
        "packed": arrow.array([7, 7, 7]).dictionary_encode(),
    }
    table = read_table(packed(tmp_path, columns))
    expected = {
        "whole": [1, np.nan, 3],
        "real": [1.5, np.nan, np.nan],
        "decimal": [1, 2, 3],
        "utc": [1_700_000_000.000001, np.nan, 1_700_000_000.010001],
        "local": [1e9, 0, -0.5],
        "day": [86400, 172800, np.nan],
        "text": [1, np.nan, 2.5],
        "iso": [86400, np.nan, 1],
        "packed": [7, 7, 7],
    }
    for name, values in expected.items():
        np.testing.assert_array_equal(table[name], values, err_msg=name)


# refusals ------------------------------------------------------------------------------------------------------------

REFUSED = {
    "empty": (b"", ("empty",)),
    "blank": (b"\n\n", ("column names",)),
    "header only": (b"a,b\n", ("column names only",)),
    "no header": (b"1,2\n3,4\n", ("line of names", "line 1")),
    "same name twice": (b"a,b,a\n1,2,3\n", ("'a' more than once",)),
    "text": (b"a,b\n1,2\n3,four\n", ("line 3", "'b'", "'four'")),
    "text first": (b"a,b\nx,2\n", ("line 2", "'a'", "columns = ")),
    "text after lines in quotes": (b'a,b\n"\n1\n",2\n3,?\n', ("line 5", "'b'")),
    "decimal comma": (b"a;b\n1,5;2\n", ("'1,5'",)),
    "underscore": (b"a\n1_000\n", ("'1_000'",)),
    "other digits": ("a\n\u0661\u0662\n".encode(), ("line 2",)),
    "infinite": (b"a\n1\ninf\n", ("finite", "line 3")),
    "too large": (b"a\n1e999\n", ("finite", "1e999")),
    "time that is none": (b"t\n2020-01-01\n2020-13-01\n", ("ISO 8601", "line 3")),
    "number among times": (b"t\n2020-01-01\n5\n", ("ISO 8601", "line 3")),
    "too many fields": (b"a,b\n1,2\n1,2,3\n", ("3 in line 3",)),
    "too few fields": (b"a,b\n1\n", ("1 in line 2",)),
    "blank in the middle": (b"a,b\n1,2\n\n3,4\n", ("0 in line 3",)),
    "open quote": (b'a,b\n1,"2\n', ("CSV",)),
    "utf-16": ("a,b\n1,2\n".encode("utf-16"), ("UTF-16",)),
    "utf-16 without mark": ("a,b\n1,2\n".encode("utf-16-le"), ("control character", "line 1")),
    "latin-1": (b"a,b\n1,2\n3,4\xb0\n", ("0xb0", "line 3")),
    "nul": (b"a,b\n1,2\n3,\0\n", ("control character", "line 3")),
    "rubbish": (bytes(range(256)), ("UTF-8",)),
    "parquet head": (b"PAR1", ("PAR1",)),
    "parquet cut": (b"PAR1" + bytes(400), ("PAR1", "cut short")),
    "parquet hollow": (b"PAR1" + bytes(400) + b"PAR1", ("Parquet",)),
    "huge footer": (b"PAR1" + bytes(40) + b"\xff\xff\xff\x7fPAR1", ("Parquet",)),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_files_are_refused_in_one_line(case, tmp_path, capfd):
    content, words = REFUSED[case]
    path = file(tmp_path, content, f"{case}.csv")
    with pytest.raises(FileError) as error:
        read_table(path)
    refused(error, path.name, *words)
    assert capfd.readouterr() == ("", "")


def test_missing_columns_are_answered_with_those_there(tmp_path):
    for path in (file(tmp_path, "a,b\n1,2\n"), packed(tmp_path, {"a": [1], "b": [2]})):
        with pytest.raises(FileError) as error:
            read_table(path, ["c"])
        refused(error, path.name, "'c'", "a, b")


def test_missing_file_and_folder(tmp_path):
    for path in (tmp_path / "none.csv", tmp_path):
        with pytest.raises(FileError) as error:
            read_table(path)
        refused(error, path.name)


def test_flipped_bits_in_parquet_pages_are_found(tmp_path):
    path = packed(tmp_path, {"a": np.arange(50) + 0.25}, compression="none", use_dictionary=False)
    data = path.read_bytes()
    at = data.index(np.float64(7.25).tobytes())
    path.write_bytes(data[: at + 6] + bytes([data[at + 6] ^ 1]) + data[at + 7 :])
    with pytest.raises(FileError) as error:
        read_table(path)
    refused(error, path.name)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"a": ["x"]}, ("row 1", "'a'")),
        ({"a": [1.0, np.inf]}, ("row 2", "finite")),
        ({"a": [[1, 2]]}, ("list", "'a'")),
        ({"a": [True]}, ("bool", "'a'")),
        ({"a": arrow.array([], arrow.float64())}, ("at least one row",)),
    ],
)
def test_parquet_columns_that_are_no_numbers(tmp_path, columns, words):
    path = packed(tmp_path, columns)
    with pytest.raises(FileError) as error:
        read_table(path)
    refused(error, path.name, *words)


def test_parquet_names_must_differ(tmp_path):
    parquet.write_table(arrow.Table.from_arrays([arrow.array([1])] * 2, ["a", "a"]), tmp_path / "t.parquet")
    with pytest.raises(FileError) as error:
        read_table(tmp_path / "t.parquet")
    refused(error, "'a' more than once")


@pytest.mark.parametrize(
    ("columns", "word"),
    [({"a": np.zeros(30_000, np.int8)}, "30000 rows"), ({"a": [1], "note": ["x" * 500_000]}, "bytes unpacked")],
)
def test_few_bytes_cannot_ask_for_much_memory(tmp_path, monkeypatch, columns, word):
    monkeypatch.setattr("motes.io.tables.LARGEST", 20_000)
    path = packed(tmp_path, columns, compression="zstd")
    assert path.stat().st_size < 3000
    with pytest.raises(FileError) as error:
        read_table(path, ["a"])
    refused(error, word)


# times ---------------------------------------------------------------------------------------------------------------


def test_intervals_of_unix_times_survive_32_bits():
    start, seconds = times(1.7e9 + 0.01 * np.arange(500))
    assert start == 1.7e9
    np.testing.assert_allclose(np.diff(seconds.astype(np.float32)), 0.01, atol=1e-6)


def test_equal_times_are_refused_on_request():
    assert times([1, 1, 2])[1].tolist() == [0, 0, 1]
    with pytest.raises(MotesError) as error:
        times([1, 1, 2], repeats=False)
    refused(error, "times", "increase", "line 3")


@pytest.mark.parametrize("bad", [[3, 5, 4], [3, 5, np.nan], [3, 5, np.inf]])
def test_times_that_run_backward_or_are_missing(bad):
    with pytest.raises(MotesError) as error:
        times(bad)
    refused(error, "times", "line 4")


@pytest.mark.parametrize(("bad", "word"), [([], "shape"), (3.0, "shape"), ([[1, 2]], "shape"), (["noon"], "numbers")])
def test_times_are_a_row_of_numbers(bad, word):
    with pytest.raises(MotesError) as error:
        times(bad)
    refused(error, "times", word)


# mutations -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_mutated_tables_are_read_or_refused(form, tmp_path):
    if form == "csv":
        path = file(tmp_path, "t,a,b\n" + "".join(f'2020-01-01T00:00:{i:02},{i / 7},"{-i}"\n' for i in range(30)))
    else:
        path = packed(
            tmp_path, {"t": arrow.array(range(30), arrow.timestamp("ms")), "a": np.arange(30) / 7, "b": ["3"] * 30}
        )
    good = path.read_bytes()
    draw = np.random.default_rng(30)
    read_table(path)
    for _ in range(200):
        data = np.frombuffer(good, np.uint8).copy()
        data[draw.integers(len(data), size=draw.integers(1, 4))] = draw.integers(256)
        path.write_bytes(data.tobytes()[: len(data) if draw.random() < 0.8 else int(draw.integers(len(data)))])
        with contextlib.suppress(FileError):
            assert not any(np.isinf(column).any() for column in read_table(path).values())


def test_dates_have_no_unit(tmp_path):
    """Of every kind of file: their numbers are none of a unit that was told."""
    when = np.array(["2020-01-01", "2020-01-02"], "datetime64[s]")
    np.savez(tmp_path / "table.npz", when=when)
    (tmp_path / "table.csv").write_text("when\n2020-01-01\n2020-01-02\n")
    (tmp_path / "table.json").write_text('[{"when": "2020-01-01"}, {"when": "2020-01-02"}]')
    own = Dialect(units={"when": "ms"})
    for path in (packed(tmp_path, {"when": when}), tmp_path / "table.csv", tmp_path / "table.json", tmp_path / "table.npz"):
        with pytest.raises(FileError, match="expected numbers in column 'when', for which a unit is given, got dates"):
            (read_arrays if path.suffix == ".npz" else read_table)(path, ["when"], dialect=own)
