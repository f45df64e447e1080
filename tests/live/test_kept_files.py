"""What others do to the files of a live run while it runs, or between two runs: emptied, removed, replaced, shared."""

import json
import os

import pytest

import motes as mo
from live_parts import folder_of, records, run, texts
from motes.cli.main import main
from motes.live import parquet
from motes.live.checkpoint import Checkpoint, identity
from motes.live.json_lines import JSONLines, to_file, to_open
from motes.live.lines import of_file
from motes.live.message import Form, Names
from motes.live.places import sink_at, sinks_at, source_at
from motes.live.sink import Guarded


def steps(path):
    return [json.loads(line)["step"] for line in path.read_text().splitlines()]


def test_what_a_shell_appends_to_is_kept_from_its_end_on(tmp_path):
    path = tmp_path / "all.jsonl"
    path.write_text('{"step": 0}\n{"step": 1}\n')
    file = os.open(path, os.O_WRONLY | os.O_APPEND)
    sink = JSONLines("standard output", file)
    kept = sink.kept()
    sink.write({"step": 2})
    sink.go_on(kept, cut=True)
    sink.close()
    assert steps(path) == [0, 1]


def test_a_sink_that_is_emptied_removed_or_replaced_while_it_runs_is_told_and_goes_on(tmp_path, caplog):
    path = tmp_path / "out.jsonl"
    sink = to_file(str(path))
    sink.write({"step": 0})
    path.write_text("")
    sink.write({"step": 1})
    assert steps(path) == [1] and "was cut from 12 to 0 bytes" in caplog.records[-1].getMessage()
    path.unlink()
    sink.write({"step": 2})
    path.rename(tmp_path / "out.1")
    path.write_text('{"step": "another\'s"}\n')
    sink.write({"step": 3})
    assert steps(tmp_path / "out.1") == [2] and steps(path) == ["another's", 3] and len(caplog.records) == 3
    size, mark = sink.kept()
    assert size == path.stat().st_size
    # what has other bytes there is another file than at the checkpoint
    sink.go_on((size - 12, mark), cut=True)
    assert steps(path) == ["another's", 3] and "another file than at the checkpoint" in caplog.records[-1].getMessage()
    sink.close()


@pytest.mark.parametrize("flags", [os.O_WRONLY, os.O_RDWR])
def test_a_file_that_is_another_one_than_at_the_checkpoint_is_not_cut(tmp_path, caplog, flags):
    """Also where its lines are as long, and it was empty then: a shell appends to another file than the last time."""
    for before in ("", '{"step": 0}\n'):
        (tmp_path / "monday").write_text(before)
        (tmp_path / "tuesday").write_text('{"step": 7}\n{"step": 8}\n')
        sinks = [JSONLines("standard output", os.open(tmp_path / day, flags | os.O_APPEND)) for day in ("monday", "tuesday")]
        kept = json.loads(json.dumps(sinks[0].kept()))
        for sink in sinks:
            sink.write({"step": 9})
            sink.go_on(kept, cut=True)
            sink.close()
        assert (tmp_path / "monday").read_text() == before and steps(tmp_path / "tuesday") == [7, 8, 9]
        assert "another file than at the checkpoint" in caplog.records[-1].getMessage()


def test_lines_begin_behind_half_a_line_of_somebody_else(tmp_path):
    path = tmp_path / "out.jsonl"
    path.write_text('{"step": 0}')
    sink = to_file(str(path))
    kept = sink.kept()
    for last in (1, 2):
        sink.go_on(kept, cut=True)
        sink.write({"step": last})
        assert steps(path) == [0, last]
    with path.open("a") as file:
        file.write("{}")
    sink.write({"step": 3})
    sink.close()
    assert path.read_text().endswith('{"step": 2}\n{}\n{"step": 3}\n')


def test_a_sink_that_another_run_writes_to_is_refused_until_that_ends(tmp_path):
    path = tmp_path / "out.jsonl"
    sink = to_file(str(path))
    with pytest.raises(mo.FileError, match="one that no other run writes to, got one in use"):
        to_file(str(path))
    with pytest.raises(mo.FileError, match="standard output: expected one that no other run writes to, got one in use"):
        to_open("standard output", os.open(path, os.O_WRONLY | os.O_APPEND))
    sink.close()
    to_file(str(path)).close()


def test_a_command_goes_on_from_another_folder(tmp_path, monkeypatch, capsys):
    path = folder_of(tmp_path, lines=6)
    (tmp_path / "elsewhere").mkdir()
    whole = (tmp_path / "in.jsonl").read_text()
    (tmp_path / "in.jsonl").write_text("".join(line + "\n" for line in whole.splitlines()[:4]))
    for folder, name in ((tmp_path, "own.toml"), (tmp_path / "elsewhere", str(path))):
        monkeypatch.chdir(folder)
        assert main(["run", name]) == 0, capsys.readouterr().err
        with (tmp_path / "track.jsonl").open("a") as file:
            file.write('{"step": "after the checkpoint"}\n')
        (tmp_path / "in.jsonl").write_text(whole)
    assert steps(tmp_path / "track.jsonl") == [*range(6), "after the checkpoint"]


def test_a_source_is_known_again_by_what_was_read_of_it(tmp_path):
    path = tmp_path / "in.jsonl"
    path.write_text('{"a": 1}\n{"a": 2}')
    source = of_file(str(path), Form(Names(("a",))))
    position = 18
    assert source.receive(0.0) and [at for _, at, _ in source.receive(0.0) or []] == [position]
    mark = source.mark(position)
    path.write_text('{"a": 1}\n{"a": 2}\n{"a": 3}\n')
    source.check(position, mark)
    for other in ('{"a": 1}\n{"a": 5}\n{"a": 3}\n', '{"a": 1}\n', ""):
        path.write_text(other)
        with pytest.raises(mo.FileError, match=f"the file that was read up to byte {position}, got another one, or one that was cut"):
            source.check(position, mark)
    source.close()


def test_parquet_has_the_same_columns_whatever_comes_and_counts_what_it_could_not_write(tmp_path, monkeypatch, caplog):
    pq = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "track.parquet"
    sink = Guarded(parquet.Parquet(str(path)))
    for step, time, number in ((0, 0.5, None), (1, 2**53 + 1, 7), (2, None, 2**64)):
        sink.write({"step": step, "time": time, "number": number, "alarm": False})
    sink.kept()
    with pytest.raises(mo.FileError, match="track.parquet: expected one that no other run writes to, got one in use"):
        parquet.Parquet(str(path))
    table = pq.read_table(path)
    assert table["number"].to_pylist() == [None, 7, None] and table["time"].to_pylist() == [0.5, float(2**53), None]
    assert [str(one) for one in table.schema.types] == ["int64", "double", "int64", "bool"] and not caplog.records

    def failing(*given, **more):
        raise OverflowError("too much")

    sink.write({"step": 3, "time": 1.0, "number": 8, "alarm": False})
    monkeypatch.setattr(pq, "write_table", failing)
    sink.kept()
    sink.close()
    parquet.Parquet(str(path)).close()
    assert sink.lost == 1 and caplog.records[-1].getMessage() == f"sink {path}: 1 records are missing."


def test_half_a_line_waits_for_its_end(tmp_path, caplog):
    path = tmp_path / "in.csv"
    for last, lines in (("0.2,1.", 1), ('{"a": 1', 1), ('{"h": {"seq": 7}', 1), ('{"a": 12}', 2)):
        path.write_text("0.1,2\n" + last)
        source = of_file(str(path), Form(Names(("a",))))
        found = [*(source.receive(0.0) or []), *(source.receive(0.0) or [])]
        assert len(found) == lines and found[0][1] == 6
        source.close()
    assert [one.getMessage() for one in caplog.records] == [f"{path}: the last line has no end and is left out until it has one."] * 3


def test_a_closed_stream_and_a_sink_that_is_the_source_are_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.stdin", None)
    monkeypatch.setattr("sys.stdout", None)
    for opened in (lambda: source_at("-", Form(Names())), lambda: sink_at("-")):
        with pytest.raises(mo.MotesError, match="-: expected an open standard stream, got one that is closed"):
            opened()
    path = tmp_path / "in.jsonl"
    path.write_text("{}")
    with pytest.raises(mo.MotesError, match="expected another file than the source, got the same"):
        sinks_at([str(path)], str(path))


def test_a_checkpoint_that_another_run_uses_is_refused_and_one_that_only_began_refuses_nothing(tmp_path):
    path = tmp_path / "run.npz"
    one, other = Checkpoint(path, identity(seed=1)), Checkpoint(path, identity(seed=2))
    with one.locked(), pytest.raises(mo.FileError, match="one that no other run uses, got one in use"), other.locked():
        pass
    with other.locked():
        pass
    one.begin({"sinks": {}})
    run_of_other = run(texts(3), path)
    assert not run_of_other.restore()
    run([], path).go(lambda: False)
    assert not path.exists(), "a run that took nothing leaves nothing"


def test_rules_of_order_may_change_between_runs_and_names_and_sizes_may_not(tmp_path, capsys):
    words = ["run", str(folder_of(tmp_path, lines=5)), "--live.sinks", str(tmp_path / "track.jsonl")]
    assert main(words) == 0
    assert main([*words, "--live.clock_jump", "stop", "--live.late", "drop"]) == 0
    for other, what in ((["--filter.n", "60"], "number of particles."), (["--data.columns", "b", "a"], "names in messages.")):
        assert main([*words, *other]) == 2
        assert f"got one of another {what} Move it away" in capsys.readouterr().err
    assert len(records(tmp_path / "track.jsonl")) == 5
