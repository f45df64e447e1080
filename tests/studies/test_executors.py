"""Workers of other processes: the same bits, nothing lost when one is killed, and what is said of it."""

import os
import signal
import threading
from concurrent.futures import Future

import pytest
from study_models import experiment

import motes as mo
from data import refused
from motes.cli.main import main
from motes.studies import executors
from motes.studies import run as running

pytestmark = [pytest.mark.jax, pytest.mark.xdist_group("cluster")]
RUNS = 30


@pytest.fixture(scope="module")
def client():
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        with distributed.Client(cluster) as client:
            yield client


@pytest.mark.night
def test_a_killed_worker_loses_nothing(client, tmp_path, monkeypatch):
    monkeypatch.setattr(executors, "EVERY", 0.0)
    processes = client.run(os.getpid)
    kept, put = [], running.Store.put

    def killing(self, *block):
        put(self, *block)
        kept.append(block[:3])
        if len(kept) == 3:
            os.kill(next(iter(processes.values())), signal.SIGKILL)

    monkeypatch.setattr(running.Store, "put", killing)
    with pytest.warns(mo.MotesWarning, match="study: worker tcp://.* is gone; what it had at hand is done again"):
        found = mo.study(f"study_models:many {RUNS}", store=tmp_path, executor=client, chunk=1)
    assert len(kept) == len(set(kept)) == 3 * RUNS
    assert found == mo.study(experiment(runs=RUNS))
    assert mo.studies.StudyResult.load(tmp_path) == found


def test_the_command_hands_its_words_to_the_workers(client, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    client.run(os.chdir, str(tmp_path))
    (tmp_path / "own.py").write_text("import motes as mo\n\ndef make():\n    return mo.textbook.growth()\n")
    asked = ["study", "own.py:make", "--filters.few", "particle", "--filters.few.n", "50", "--runs", "6", "--steps", "5"]
    assert main([*asked, "--scheduler", client.scheduler.address, "--out", "there"]) == 0
    assert main([*asked, "--out", "here"]) == 0
    there, here = (mo.studies.StudyResult.load(tmp_path / folder / "runs") for folder in ("there", "here"))
    assert there == here and "Results are in" in capsys.readouterr().out
    # what the user got wrong is one line, wherever it is noticed
    (tmp_path / "own.py").unlink()
    assert main([*asked, "--scheduler", client.scheduler.address, "--out", "again"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_scheduler_that_is_not_there_is_one_line(monkeypatch):
    distributed, asked = pytest.importorskip("distributed"), []

    def silent(address, timeout):
        asked.append(address)
        raise OSError(f"Timed out trying to connect to {address}")

    monkeypatch.setattr(distributed, "Client", silent)
    with pytest.raises(mo.MotesError) as error:
        executors.client("nowhere at all")
    refused(error, "scheduler: expected the address of a Dask scheduler, such as tcp://127.0.0.1:8786, got 'nowhere at all'")
    assert not asked  # no client is left behind that does not know where it belongs
    with pytest.raises(mo.MotesError) as error:
        executors.client("tcp://127.0.0.1:1")
    refused(error, "'tcp://127.0.0.1:1' (Timed out trying to connect to tcp://127.0.0.1:1). Is `dask scheduler` running there")


class LastFirst:
    """An executor of which a thread works off what was handed out, the last first, once nothing more is handed out."""

    def __init__(self):
        self.waiting, self.most, self.there = [], 0, threading.Condition()
        threading.Thread(target=self.work, daemon=True).start()

    def submit(self, function, *arguments):
        future = Future()
        with self.there:
            self.waiting.append((future, function, arguments))
            self.most = max(self.most, len(self.waiting))
            self.there.notify()
        return future

    def work(self):
        while True:
            with self.there:
                self.there.wait_for(lambda: self.waiting, timeout=5)
                if not self.waiting:
                    return
                future, function, arguments = self.waiting.pop()
            future.set_result(function(*arguments))


def test_blocks_are_handed_out_as_others_come_back(monkeypatch):
    monkeypatch.setattr(running, "WINDOW", 4)
    executor = LastFirst()
    assert mo.study("study_models:experiment", executor=executor, chunk=2) == mo.study(experiment())
    assert executor.most <= 4


def test_processes_that_die_over_a_block_are_told_in_one_line():
    class BrokenProcessPool(Exception):
        pass

    class Broken:
        def submit(self, function, *arguments):
            future = Future()
            future.set_exception(BrokenProcessPool("a process ended abruptly"))
            return future

    with pytest.raises(mo.MotesError) as error:
        mo.study("study_models:experiment", executor=Broken())
    refused(error, "study executor: expected processes that live until their work is done, got BrokenProcessPool: a process ended abruptly")
