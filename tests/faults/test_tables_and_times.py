"""Tables and times: those with units, comments, other marks and forms are read; cures fit what is wrong and name the place."""

import gzip
from datetime import UTC, datetime

import numpy as np
import pytest
from told import refusal

from motes.core.checks import FileError
from motes.io.tables import read_table, times

pandas = pytest.importorskip("pandas")

# times ---------------------------------------------------------------------------------------------------------------

MOMENTS = ["2024-01-01T00:00:00", "2024-01-01T06:00:00", "2024-01-03T00:00:00"]
FORMS = {
    **{f"datetime64[{unit}]": (lambda unit=unit: np.array(MOMENTS, f"datetime64[{unit}]")) for unit in ("h", "m", "s", "ms", "us", "ns")},
    "datetime64[25s]": lambda: np.array(MOMENTS, "datetime64[s]").astype("datetime64[25s]"),
    "objects": lambda: [datetime.fromisoformat(text) for text in MOMENTS],
    "objects with a zone": lambda: np.array([datetime.fromisoformat(text + "+00:00") for text in MOMENTS]),
    "pandas index": lambda: pandas.to_datetime(MOMENTS),
    "pandas column": lambda: pandas.Series(pandas.to_datetime(MOMENTS)),
    "pandas with a zone": lambda: pandas.Series(pandas.to_datetime(MOMENTS).tz_localize("UTC")),
    "pandas elsewhere": lambda: pandas.to_datetime(MOMENTS).tz_localize("UTC").tz_convert("Asia/Tokyo"),
    "pandas in milliseconds": lambda: pandas.to_datetime(MOMENTS).as_unit("ms"),
    "a list of pandas": lambda: list(pandas.to_datetime(MOMENTS)),
    "seconds": lambda: [datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp() for text in MOMENTS],
}


@pytest.mark.parametrize("form", FORMS)
def test_times_of_any_unit_are_seconds(form):
    start, seconds = times(FORMS[form]())
    assert start == 1704067200.0 and seconds.dtype == np.float64 and seconds.tolist() == [0, 21600, 172800]


def test_nanoseconds_keep_their_differences_and_durations_their_lengths():
    ticks = np.array(["2024-01-01T00:00:00.000000000", "2024-01-01T00:00:00.000000123"], "datetime64[ns]")
    assert times(ticks)[1][1] == pytest.approx(123e-9, rel=1e-12)
    assert times(np.array([0, 1500, 4000], "timedelta64[ms]"))[1].tolist() == [0, 1.5, 4]
    assert times(np.array([2, 4], "timedelta64[D]"))[0] == 172800
    refusal(lambda: times(np.array([2, 4], "timedelta64[M]")), "Months differ in length")


@pytest.mark.parametrize("bad", [np.array(["2024-01-01", "NaT"], "datetime64[ns]"), [datetime(2024, 1, 1), None],
                                 np.array(["2024-01-02", "2024-01-01"], "datetime64[D]")])
def test_times_that_are_missing_or_go_back_are_named(bad):
    refusal(lambda: times(bad), "row 2")


# tables --------------------------------------------------------------------------------------------------------------


def table(folder, text, name="table.csv"):
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return folder / name


@pytest.mark.parametrize("text", [
    "# made by hand\n#\na,b\n1,2\n# a pause\n,3\n", "#x\r\na;b\r\n1;2\r\n#;;;;\r\nN/A;3\r\n", "a,b\n1,2\n#N/A,3\n",
    "a,b\n1,2\n<NA>,3\n", "a,b\n1,2\nnull,3\n",
    '[{"a": 1, "b": 2}, {"a": null, "b": 3}]', '{"a": {"0": 1, "1": null}, "b": {"0": 2, "1": 3}}', '{"a": [1, null], "b": [2, 3]}',
    '\ufeff[{"a": "1", "b": 2}, {"b": "3"}]',
])
@pytest.mark.parametrize("packed", [False, True])
def test_comments_and_marks_of_missing_numbers_and_other_forms(tmp_path, text, packed):
    data = gzip.compress(text.encode()) if packed else text.encode()
    found = read_table(table(tmp_path, data, "any.name"))
    np.testing.assert_array_equal(found["a"], [1, np.nan])
    np.testing.assert_array_equal(found["b"], [2, 3])


TOLD = {
    "another mark of comments": ("% logger 7\na,b\n1,2\n", ("a line of column names", 'Set comment = "%"')),
    "names behind another mark": ("// a b\n1 2\n", ("'// a b'", "the line of names has no mark")),
    "names behind a mark": ("# a,b\n1,2\n3,4\n", ("line 2", "Take the mark of comments off")),
    "decimal commas between semicolons": ("a;b\n1,5;2\n", ("line 2", "'a'", 'decimal = ","')),
    "decimal commas between commas": ("a,b\n1,5,2,5\n", ("4 in line 2", "decimal points")),
    "day first": ("a,b\n31.01.2024,2\n", ("line 2", 'time_format = "day first"')),
    "day first with strokes": ("a,b\n31/01/2024 12:30,2\n", ('time_format = "day first"', "time_zone")),
    "time of the day": ("a,b\n12:30:15,2\n", ('time_format = "%H:%M:%S"',)),
    "zone by name": ("a,b\n2024-01-31T12:30:00 CET,2\n", ("offset of local times",)),
    "line after comments": ("# x\n# y\na,b\n1,2\n# z\n3,four\n", ("line 6", "'b'")),
}


@pytest.mark.parametrize("case", TOLD)
def test_cures_fit_the_table(tmp_path, case):
    text, words = TOLD[case]
    for columns in (None, ["a", "b"]):
        refusal(lambda columns=columns: read_table(table(tmp_path, text), columns), "table.csv", *words)
    with pytest.raises(FileError) as error:
        read_table(table(tmp_path, text), ["a", "b"])
    assert "columns=" not in str(error.value)


@pytest.mark.parametrize(("data", "words"), [
    (b'[{"a": 1}, 3]', ("another form",)),
    (b'{"a": [1, 2], "b": [1]}', ("one length",)),
    (b'[{"a": 1, "a": 2}]', ("twice",)),
    (b'[{"a": 1e999}]', ("finite", "row 1")),
    (b'[{"a": [1]}]', ("row 1", "'a'")),
    (b'[{"a": true}]', ("row 1", "'True'")),
    (b"[{" * 5000, ("JSON",)),
    (b"[]", ("at least one",)),
    (gzip.compress(b"a,b\n1,2\n", mtime=0)[:-6], ("gzip",)),
    (gzip.compress(b"a,b\n1,2\n", mtime=0) + b"more", ("gzip",)),
])
def test_json_and_gzip_that_are_no_tables_are_refused(tmp_path, data, words):
    refusal(lambda: read_table(table(tmp_path, data, "t.json.gz")), "t.json.gz", *words)


def test_gzip_cannot_ask_for_much_memory(tmp_path):
    refusal(lambda: read_table(table(tmp_path, gzip.compress(bytes(1 << 27)), "t.csv.gz")), "t.csv.gz", "unpacked")
