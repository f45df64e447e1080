"""The command: from a file, through a kill and a signal to end, to the same lines; and by night a hundred kills."""

import json
import random
import signal
import socket
import subprocess
import time
from pathlib import Path

import pytest

from live_parts import command, folder_of, records
from motes.cli.main import main

LINES = 1500
KILLS, SEED = 30, 5
MOST = 120.0
"""Seconds in which a process must come to something."""


def begun(folder, *words):
    words, surroundings = command("run", folder / "own.toml", *words)
    return subprocess.Popen(words, env=surroundings, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                            text=True)  # fmt: skip


def until(holds, process):
    end = time.monotonic() + MOST
    while not holds():
        assert process.poll() is None and time.monotonic() < end, process.stderr.read()
        time.sleep(0.002)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """What an uninterrupted run writes."""
    folder = tmp_path_factory.mktemp("whole")
    folder_of(folder, lines=LINES, swapped=range(5, LINES - 5, 50))
    assert main(["run", str(folder / "own.toml"), "--live.sinks", str(folder / "track.jsonl")]) == 0
    return records(folder / "track.jsonl")


def test_a_run_that_was_told_to_end_and_one_that_was_killed_go_on_to_the_same_lines(tmp_path, whole):
    assert [one["step"] for one in whole][-1] == LINES - 1 and sum(one["late"] > 0 for one in whole) > 20
    path = folder_of(tmp_path, lines=LINES, swapped=range(5, LINES - 5, 50))
    process = begun(tmp_path)
    track = tmp_path / "track.jsonl"
    until(lambda: track.exists() and track.stat().st_size > 5_000, process)
    process.send_signal(signal.SIGTERM)
    err = process.communicate(timeout=MOST)[1]
    assert process.returncode == 143, err
    last = err.splitlines()[-1]
    assert last.startswith("motes run: ended by SIGTERM; what was done is kept in ") and "particle.live.npz (step " in last
    cut = len(records(tmp_path / "track.jsonl"))
    assert 0 < cut < LINES and not list((tmp_path / "out").glob(".*"))
    with (tmp_path / "track.jsonl").open("a") as file:
        file.write('{"step": "after the checkpoint, as a killed run leaves it"}\n')
    assert main(["run", str(path), "--live.sinks", str(tmp_path / "track.jsonl")]) == 0
    assert records(tmp_path / "track.jsonl") == whole
    assert main(["run", str(path), "--live.sinks", str(tmp_path / "track.jsonl")]) == 0
    assert records(tmp_path / "track.jsonl") == whole, "nothing more has come"


@pytest.mark.parametrize(("words", "why"), [
    (("--source", "udp://127.0.0.1:{busy}"), "with a free port, got Address already in use"),
    (("--source", "udp://127.0.0.1:0", "--live.patience", "0.05"), "expected a message within 0.05 s, got none"),
    (("--budget", "5"), "budget: expected a time with its unit"),
    (("--live.lag", "-1"), "live lag: expected a whole number of at least 0"),
    (("--live.lag", "9" * 30), "live lag: expected at most 100000 steps"),
    (("--live.columns", "a", "a"), "live columns: expected names that differ, got 'a, a'"),
    (("--live.fields", "t", "a", "a"), "live fields: expected names that differ"),
    (("--filters.a", "kalman", "--filters.b", "kalman"), "expected one filter, got a, b"),
    (("--live.late", "later"), "later"),
])  # fmt: skip
def test_what_cannot_be_is_one_line(tmp_path, capsys, words, why):
    path = folder_of(tmp_path, lines=3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as busy:
        busy.bind(("127.0.0.1", 0))
        words = [word.format(busy=busy.getsockname()[1]) for word in words]
        assert main(["run", str(path), "--live", "--out", str(tmp_path / "out"), *words]) == 2
    err = [line for line in capsys.readouterr().err.splitlines() if line.startswith("motes run: ")]
    assert len(err) == 1 and why in err[0]


def test_without_a_source_or_for_many_targets_it_says_so(tmp_path, capsys):
    path = folder_of(tmp_path, source="", lines=3)
    assert main(["run", str(path), "--live"]) == 2
    assert "live source: expected where measurements come from, got none" in capsys.readouterr().err
    assert main(["demo", "robot", "--live"]) == 2
    assert "motes run" in capsys.readouterr().err


def test_the_robot_is_replayed_and_its_messages_are_taken_from_text(tmp_path, capsys):
    """An application: its own recording row by row, and the same rows as JSON."""
    words = ["run", "robot", "--seconds", "60", "--n", "100", "--live", "--out", str(tmp_path), "--live.speed", "0"]
    assert main([*words, "--live.sinks", str(tmp_path / "a.jsonl")]) == 0
    replayed = records(tmp_path / "a.jsonl")
    assert "messages: 391 taken." in capsys.readouterr().err and not list(tmp_path.glob("*.npz"))
    from motes.applications.robot.job import load
    from motes.applications.robot.settings import Settings

    job = load(Settings(seconds=60.0), 0)
    lines = [json.dumps({"time": time, "y": [None if one != one else one for one in map(float, y)], "forward": float(forward),
                         "turn": float(turn)})
             for time, y, forward, turn in zip(job.times.tolist(), job.ys, job.inputs.forward, job.inputs.turn, strict=True)]  # fmt: skip
    (tmp_path / "in.jsonl").write_text("\n".join(lines))
    assert main([*words, "--source", str(tmp_path / "in.jsonl"), "--live.sinks", str(tmp_path / "b.jsonl")]) == 0
    assert records(tmp_path / "b.jsonl") == replayed


@pytest.mark.night
def test_a_hundred_kills_leave_nothing_half_written_and_change_no_bit(tmp_path, whole):
    draw, kills, rounds = random.Random(SEED), 0, 0
    while kills < KILLS:
        folder = tmp_path / str(rounds)
        folder.mkdir()
        folder_of(folder, lines=LINES, swapped=range(5, LINES - 5, 50))
        rounds += 1
        while True:
            process = begun(folder)
            track = Path(folder / "track.jsonl")
            before = track.stat().st_size if track.exists() else 0
            until(lambda: process.poll() is not None or (track.exists() and track.stat().st_size != before), process)  # noqa: B023
            time.sleep(draw.expovariate(4.0))
            process.kill()
            process.communicate()
            if process.returncode == 0:
                break
            kills += 1
            records(track)  # all lines are whole
            half = [one.name for one in (folder / "out").glob(".*")] if (folder / "out").exists() else []
            assert all(name.startswith(".particle.live.npz.") for name in half), half
        assert records(track) == whole and not list((folder / "out").glob(".*"))
