"""The loop: checkpoints that cannot be written, measurements that nothing explains, steps that run late, watchers."""

import json
import time
from types import SimpleNamespace

import numpy as np
import pytest

import motes as mo
from live_parts import FILTER, MODEL, Given, Kept, form, run, same, texts, went
from motes.filters.resized import resized
from motes.live import pace
from motes.live.checkpoint import identity
from motes.live.loop import Run, Work
from motes.live.settings import Live
from motes.live.sink import Guarded


def test_a_live_run_has_the_bits_of_a_run():
    lines = texts(20)
    sink, found = went(lines)
    rows = [json.loads(line) for line in lines]
    ys = np.array([[row["a"]] for row in rows])
    inputs = {"dt": np.diff([row["t"] for row in rows], prepend=0.0).astype(np.float32), "push": np.array([row["push"] for row in rows])}
    history = mo.run(1, FILTER, MODEL, ys, inputs)
    assert np.array_equal([row["mean east"] for row in sink], np.asarray(history.mean)[:, 0].astype(float))
    assert np.array_equal([row["log_evidence"] for row in sink], np.asarray(history.info.log_evidence).astype(float))


def test_a_checkpoint_of_another_run_or_a_damaged_one_is_one_line(tmp_path):
    path, lines = tmp_path / "run.npz", texts(5)
    run(lines, path).go(lambda: False)
    other = run(lines, path)
    other.checkpoint._identity = identity(source="-", seed=2, number_of_particles=9)
    with pytest.raises(mo.FileError, match="one of this run, got one of another seed, number of particles. Move it away"):
        other.restore()
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(mo.FileError, match="Move it away, or set resume = false"):
        run(lines, path).restore()
    assert not run(lines, path, resume=False).restore()


def test_where_no_checkpoint_can_be_written_the_filter_goes_on(tmp_path, caplog, monkeypatch):
    (tmp_path / "file").touch()
    lines = texts(30)
    found = run(lines, tmp_path / "file" / "run.npz", checkpoint=1e-6)
    found.go(lambda: False)
    assert same(found, went(lines)[1])
    told = [one.getMessage() for one in caplog.records if "checkpoint" in one.getMessage()]
    assert len(told) == 1 and told[0].endswith("the filter goes on.") and "\n" not in told[0]
    caplog.clear()

    def full(file):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", full)
        run(lines, tmp_path / "run.npz", checkpoint=1e-6).go(lambda: False)
    assert [one.getMessage() for one in caplog.records] == [
        f"checkpoint: {tmp_path}/run.npz: expected a file that can be written, got No space left on device; the filter goes on."]
    assert [one.name for one in tmp_path.iterdir()] == ["file"]


def test_what_nothing_explains_and_what_does_not_fit_is_left_out(caplog):
    lines = texts(12)
    wrong = list(lines)
    wrong[5] = json.dumps(json.loads(lines[5]) | {"a": 1e9}).encode()
    wrong[8] = json.dumps(json.loads(lines[8]) | {"a": 1e300}).encode()
    blank = [line if place not in (5, 8) else json.dumps(json.loads(line) | {"a": None}).encode() for place, line in enumerate(lines)]
    sink, found = went(wrong)
    assert same(found, went(blank)[1]) and found.counts.of["collapsed"] == 1 and found.counts.of["refused"] == 1
    assert len(caplog.records) == 2
    first = went([wrong[8], *lines[9:]])[1]
    assert first.stream.t == 2, "a first message that does not fit is no step"


def test_watchers_see_each_step_and_numbers_without_time_are_steps():
    seen = []
    lines = texts(6)
    run(lines, watchers=[lambda stream, taken: seen.append((stream.t, taken.time, taken.y[0], taken.seconds > 0))]).go(lambda: False)
    assert [one[0] for one in seen] == list(range(6)) and seen[2] == (2, 0.2, json.loads(lines[2])["a"], True)


@pytest.mark.parametrize("came", [[], [(b"no message", None, None)]], ids=["nothing", "nonsense"])
def test_a_source_that_never_comes_is_one_line(monkeypatch, caplog, came):
    monkeypatch.setattr("motes.live.silence.SILENCE", 0.02)
    shape = form()
    silent = Given([], shape)
    silent.receive = lambda timeout: time.sleep(0.02) or came
    given = "[0-9]+ that could not be read" if came else "none"
    with pytest.raises(mo.MotesError, match=f"source given: expected a message within 0.2 s, got {given}"):
        Run(Work(1, FILTER, MODEL, shape), silent, Live(patience=0.2)).go(lambda: False)
    said = "and none could be read" if came else "nothing has come from given for"
    silence = [one.getMessage() for one in caplog.records if said in one.getMessage()]
    assert 1 < len(silence) < 6


def test_a_law_with_fewer_particles_is_the_same_law():
    stream = mo.stream(1, mo.ParticleFilter(n=4096), MODEL, {"dt": 0.1, "push": 0.0}, lag=3)
    for k in range(4):
        stream.update(np.array([0.3]))
        if k < 3:
            stream.predict({"dt": 0.1, "push": 0.1})
    mean, sd, evidence = float(stream.mean[0]), float(stream.cov[0, 0]) ** 0.5, float(stream.log_likelihood)
    stream.resize(mo.ParticleFilter(n=1024))
    assert stream.state.particles.shape == (1, 1024) and stream.t == 3 and float(stream.log_likelihood) == evidence
    assert abs(float(stream.mean[0]) - mean) < 0.05 * sd and abs(float(stream.cov[0, 0]) ** 0.5 / sd - 1) < 0.1
    with pytest.raises(mo.MotesError, match="back steps"):
        stream.back(1)
    stream.predict({"dt": 0.1, "push": 0.0})
    stream.update(np.array([0.2]))
    around = mo.Recovering(mo.ParticleFilter(n=8), lambda key, y, u, t: y)
    assert around.fixed_count == 8 and around.with_particles(16).fixed_count == 16 and mo.KalmanFilter().fixed_count is None
    assert mo.Recovering(mo.AdaptiveSize(mo.ParticleFilter(n=8), (4, 8), (1.0,)), lambda key, y, u, t: y).fixed_count is None
    with pytest.raises(mo.MotesError, match="number of particles"):
        resized(None, mo.Gaussian([0.0], [[1.0]]), mo.KalmanFilter())


def test_back_and_again_has_the_same_bits():
    u = {"dt": 0.1, "push": 0.1}
    stream, other = (mo.stream(1, FILTER, MODEL, u, lag=3) for _ in range(2))
    for one, steps in ((stream, (0.1, 0.2, 0.9, 0.8)), (other, (0.1, 0.2, 0.3, 0.4))):
        one.update([steps[0]])
        for y in steps[1:]:
            one.predict(u)
            one.update([y])
    stream.back(2)
    for y in (0.3, 0.4):
        stream.predict(u)
        stream.update([y])
    assert np.array_equal(stream.state.particles, other.state.particles) and stream.t == 3
    with pytest.raises(mo.MotesError, match="back steps: expected at most 3, which are kept, got 4"):
        stream.back(4)
    stream.back(0)
    stream.insert([np.nan], 2)


def test_steps_that_keep_running_late_are_told_and_taken_with_fewer_particles(monkeypatch, caplog):
    monkeypatch.setattr(pace, "LOOKED_AT", 10)
    monkeypatch.setattr(pace, "FEWEST", 16)
    monkeypatch.setattr(pace, "fitting", lambda filter, *rest: filter)
    smaller = FILTER.with_particles(32)
    monkeypatch.setattr(pace.Pace, "ahead", lambda self, filter: setattr(self, "_next", smaller if filter.n > 32 else None))
    found = run(texts(60), budget=1e-9)
    found.go(lambda: False)
    told = [one.getMessage() for one in caplog.records]
    assert len(told) == 2 and "100 percent of the last 10 steps took longer" in told[0]
    assert "from step 19 on there are 32 particles" in told[1]
    assert found.stream.filter.n == 32 and found.stream.t == 59 and found.stream.state.particles.shape == (1, 32)


def test_a_budget_chooses_the_number_of_particles(monkeypatch, caplog):
    monkeypatch.setattr(pace, "TRIED", (100, 300))
    monkeypatch.setattr(pace, "timed", lambda filter, *rest: 1e-4 + 1e-6 * filter.n)
    chosen = pace.fitting(FILTER, None, None, None, 2e-3)
    assert chosen.n == 896 and pace.fitting(FILTER, None, None, None, 1e-4).n == FILTER.n
    monkeypatch.setattr(pace, "timed", lambda filter, *rest: 1e-3 - 1e-7 * filter.n)
    assert pace.fitting(FILTER, None, None, None, 5e-3).n == 300 and pace.fitting(FILTER, None, None, None, 1e-3).n == 100
    monkeypatch.setattr(pace, "timed", lambda filter, *rest: 1e-4 + 1e-6 * filter.n)
    assert pace.fitting(FILTER, None, None, None, 1e-4).n == FILTER.n
    assert "budget" in caplog.records[-1].getMessage() and "begins with 64 particles" in caplog.records[-1].getMessage()


def test_a_run_that_was_killed_before_its_first_checkpoint_begins_its_lines_anew(tmp_path):
    path, lines, sink = tmp_path / "run.npz", texts(10), Kept()
    killed = run(lines[:4], path, sink)
    killed.save = lambda: False
    killed.go(lambda: False)
    assert len(sink.records) == 4 and path.exists()
    again = run(lines, path, sink)
    assert not again.restore() and not sink.records
    again.go(lambda: False)
    assert [record["step"] for record in sink.records] == list(range(10))


def test_a_sink_that_was_not_there_before_is_not_cut(tmp_path):
    path, lines = tmp_path / "run.npz", texts(10)
    run(lines[:4], path).go(lambda: False)
    other = Kept()
    other.name, other.records = "other", [{"step": "as it was"}]
    again = run(lines, path, other)
    assert again.restore() and len(other.records) == 1


def test_a_restarted_run_has_the_size_that_it_had(tmp_path):
    path, lines = tmp_path / "run.npz", texts(10)
    first = run(lines[:6], path)
    first._filter = FILTER.with_particles(32)
    first.go(lambda: False)
    again = run(lines, path, sink=Kept())
    assert again.restore() and again.stream.filter.n == 32 and again.stream.t == 5
    again.go(lambda: False)
    assert again.stream.t == 9


def test_what_had_come_and_was_not_taken_is_counted_where_it_cannot_be_read_again():
    for repeats, left in ((True, 0), (False, 4)):
        found = run(texts(20))
        found.source.repeats = repeats
        found.go(lambda found=found: found.counts.of["steps"] == 3)
        assert found.counts.of["left"] == left
    assert found.counts.told() == "messages: 3 taken; 4 had come and were not taken when it was told to end."


def test_a_sink_that_nobody_reads_ends_the_run_and_loses_no_record_of_others(tmp_path):
    class Left(Kept):
        name = "left"

        def write(self, record):
            if len(self.records) == 2:
                raise BrokenPipeError
            super().write(record)

    lines, sink = texts(6), Kept()
    first = run(lines, tmp_path / "run.npz", sink)
    first.sinks.insert(0, Guarded(Left()))
    with pytest.raises(BrokenPipeError):
        first.go(lambda: False)
    again = run(lines, tmp_path / "run.npz", sink)
    assert again.restore()
    again.go(lambda: False)
    assert [record["step"] for record in sink.records] == list(range(6))


def test_what_was_taken_before_a_silence_is_saved_during_it_and_once(tmp_path, monkeypatch):
    found, saved, quiet = run(texts(5), tmp_path / "run.npz"), [], iter(range(1, 21))
    given, save, clock = found.source.receive, found.save, [0.0]
    monkeypatch.setattr("motes.live.loop.time", SimpleNamespace(monotonic=lambda: clock[0], perf_counter=time.perf_counter))

    def receive(timeout):
        came = given(timeout)
        if came is not None or next(quiet, None) is None:
            return came
        clock[0] += 3.0
        return []

    found.source.receive, found.save = receive, lambda: saved.append(clock[0]) or save()
    found.go(lambda: False)
    assert saved == [12.0, 60.0] and found.checkpoint.step == 4
