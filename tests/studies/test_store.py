"""A store survives kills, refuses other experiments, and names what is damaged."""

import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from study_models import experiment, model

import motes as mo
from data import refused
from motes.core.checks import FileError
from motes.studies.store import LEDGER, Store
from tiers import NIGHT

RUNS = 80
CHILD = """
import signal
import sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell that starts the suite in its background has it ignored
import motes as mo
from motes.studies.store import Store
from study_models import experiment
keep = Store.put
def told(self, part, start, stop, arrays):
    keep(self, part, start, stop, arrays)
    print(f"{part or 'truth'},{start},{stop}", flush=True)
    sys.stdin.readline()  # on a busy machine it would be done before it is killed
Store.put = told
mo.study(experiment(runs=int(sys.argv[2])), store=sys.argv[1], chunk=1)
print("end", flush=True)
"""


def child(folder, cache):
    here = Path(__file__).parent
    paths = [str(here), str(here.parent), *filter(None, sys.path)]
    surroundings = os.environ | {"PYTHONPATH": os.pathsep.join(paths), "JAX_COMPILATION_CACHE_DIR": str(cache),
                                 "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0", "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1"}
    return subprocess.Popen([sys.executable, "-c", CHILD, str(folder), str(RUNS)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                            stderr=subprocess.PIPE, text=True, env=surroundings, start_new_session=True)


def blocks_of(folder):
    with sqlite3.connect(f"file:{folder / LEDGER}?mode=ro", uri=True) as ledger:
        return [(part or "truth", start, stop) for part, start, stop in ledger.execute(
            "SELECT part.name, start, stop FROM block JOIN part ON part.number = block.part")]


def test_killed_at_any_moment_nothing_is_lost_or_done_twice(tmp_path):
    chance, told, ended = random.Random(20), [], False  # noqa: NPY002
    kills = 6 if NIGHT else 3
    for kill in range(kills):
        process = child(tmp_path / "out", tmp_path / "cache")
        for _ in range(chance.randint(1, 8)):
            line = process.stdout.readline().strip()
            if line in ("end", ""):
                ended = line == "end"
                break
            part, start, stop = line.split(",")
            told.append((part, int(start), int(stop)))
            process.stdin.write("\n")
            process.stdin.flush()
        time.sleep(chance.uniform(0, 0.03))
        process.send_signal(signal.SIGKILL if kill < kills - 1 else signal.SIGINT)
        rest, errors = process.communicate(timeout=60)
        told += [(part, int(start), int(stop)) for part, start, stop in (line.split(",") for line in rest.splitlines() if "," in line)]
        assert not ended
        known = blocks_of(tmp_path / "out")
        assert len(known) == len(set(known))
        # what was reported is there, and at most the block at hand besides
        assert set(told) <= set(known) and len(known) <= len(told) + kill + 1, (kill, errors)
    assert len(told) == len(set(told)), "a block was computed twice"
    assert 3 * kills <= len(told) < 3 * RUNS
    assert process.returncode != 0 and f"of {2 * RUNS} runs are in {tmp_path / 'out'}. The same call goes on from there" in errors
    (tmp_path / "out" / ".part001-0000000-0000001.npz.0123456789abcdef").write_bytes(b"unfinished")
    assert mo.study(experiment(runs=RUNS), store=tmp_path / "out", chunk=5) == mo.study(experiment(runs=RUNS))
    assert not list((tmp_path / "out").glob(".part*"))


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("store")
    return folder, mo.study(experiment(), store=folder, chunk=4)


@pytest.fixture
def store(finished, tmp_path):
    return Path(shutil.copytree(finished[0], tmp_path / "out"))


def files_of(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix == ".npz"}


def test_more_runs_and_filters_come_to_a_store(store, finished):
    before = files_of(store)
    filters = experiment().filters | {"third": mo.ParticleFilter(n=12)}
    larger = experiment(runs=14, filters=filters, lost=("place", 2.0))
    found = mo.study(larger, store=store)
    assert found == mo.study(larger)
    after = files_of(store)
    assert before.items() < after.items() and len(after) == len(before) + 3 + 2
    np.testing.assert_array_equal(found.estimates[:2, :10], finished[1].estimates)
    assert mo.studies.StudyResult.load(store) == found
    assert mo.study(experiment(runs=5), store=store) == mo.study(experiment(runs=5))
    assert files_of(store) == after


OTHERS = {
    "steps": (dict(steps=8), "another steps (7 there, 8 here)"),
    "seed": (dict(seed=4), "another seed (3 there, 4 here)"),
    "parameters": (
        dict(filters={"first": mo.ParticleFilter(n=41), "second": experiment().filters["second"]}), "another filter 'first'"),
    "blocks": (dict(blocks={"a": "a"}), "another blocks"),
    "inputs": (dict(inputs=np.arange(7.0)), "inputs"),
    "track": (dict(track=np.ones((7, 2))), "another track"),
}


@pytest.mark.parametrize("name", OTHERS)
def test_another_experiment_is_refused_by_what_differs(store, name):
    before = files_of(store)
    with pytest.raises(FileError) as error:
        mo.study(experiment(**OTHERS[name][0]), store=store)
    refused(error, store, "the experiment that this store was begun with", OTHERS[name][1], "Use another folder.")
    assert files_of(store) == before


def test_another_model_is_refused_by_its_part(store):
    plan = experiment()
    for other in (model(gain=1.001), model(noise=0.41), model(offsets=(0.1, 1e-6))):
        with pytest.raises(FileError) as error:
            mo.study(mo.Experiment(other, plan.filters, 7, 10, 3, blocks=dict(plan.blocks)), store=store)
        refused(error, "another model sensor.")
    assumed = {"first": (plan.filters["first"], plan.model)} | {"second": plan.filters["second"]}
    with pytest.raises(FileError, match="another filter 'first'"):
        mo.study(experiment(filters=assumed), store=store)
    rebuilt = mo.Experiment(model(), plan.filters, 7, 10, 3, blocks=dict(plan.blocks))
    assert mo.study(rebuilt, store=store) == mo.studies.StudyResult.load(store)


def test_other_versions_are_refused(store, monkeypatch):
    from motes.studies import identity

    made = identity.provenance()
    monkeypatch.setattr(identity, "provenance", lambda: made | {"jax_version": "9.9.9"})
    with pytest.raises(FileError, match=r"jax version \(\S+ there, '?9.9.9'? here\)"):
        mo.study(experiment(), store=store)


def test_functions_that_cannot_be_compared_need_another_way(tmp_path):
    import jax

    def called(x, u, t):
        return jax.pure_callback(lambda x: x, jax.ShapeDtypeStruct((2,), x.dtype), x, vmap_method="sequential")

    strange = mo.StateSpaceModel(model().initial, model().dynamics, mo.AdditiveGaussian(called, np.eye(2)), ("a", "b"))
    with pytest.raises(mo.MotesError) as error:
        mo.study(mo.Experiment(strange, {"pf": mo.ParticleFilter(n=9)}, 3, 2), store=tmp_path)
    refused(error, "store: model sensor", "functions that can be compared by their traced programs", "called")


def flip(path, place):
    data = bytearray(path.read_bytes())
    data[int(place * len(data))] ^= 0x10
    path.write_bytes(data)


DAMAGE = {
    "flipped": lambda path: flip(path, 0.4),
    "cut": lambda path: path.write_bytes(path.read_bytes()[:-7]),
    "missing": lambda path: path.unlink(),
    "empty": lambda path: path.write_bytes(b""),
    "swapped": lambda path: shutil.copy(path.parent / "part001-0000004-0000008.npz", path),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_damaged_files_are_named_and_repaired(store, finished, kind):
    path = store / "part002-0000000-0000004.npz"
    DAMAGE[kind](path)
    for attempt in (lambda: mo.study(experiment(), store=store), lambda: mo.studies.StudyResult.load(store)):
        with pytest.raises(FileError) as error:
            attempt()
        refused(error, path.name, "the runs as they were written", "no such file" if kind == "missing" else "a damaged file", "repair=True")
    assert mo.study(experiment(), store=store, repair=True) == finished[1]
    assert mo.studies.StudyResult.load(store) == finished[1]


def test_damage_to_the_ledger_is_found_or_harmless(store, finished):
    """At 60 places over the ledger, a flipped bit gives an error that names the ledger or a file, or the very same result."""
    ledger = store / LEDGER
    good, found = ledger.read_bytes(), 0
    for place in np.linspace(0, 0.9999, 60):
        flip(ledger, place)
        try:
            assert mo.studies.StudyResult.load(store) == finished[1]
        except FileError as error:
            assert LEDGER in str(error) or "part0" in str(error), error
            found += 1
        ledger.write_bytes(good)
    assert found >= 10


@pytest.mark.parametrize("table", ["field", "part", "block"])
def test_rows_that_vanish_are_missed(store, table):
    """A page that claims one row less than it holds; what it still shows is well formed."""
    with sqlite3.connect(store / LEDGER) as ledger:
        page = ledger.execute("SELECT rootpage FROM sqlite_master WHERE name = ?", (table,)).fetchone()[0]
        size = ledger.execute("PRAGMA page_size").fetchone()[0]
    ledger.close()
    data = bytearray((store / LEDGER).read_bytes())
    place = (page - 1) * size + 3
    data[place : place + 2] = (int.from_bytes(data[place : place + 2]) - 1).to_bytes(2)
    (store / LEDGER).write_bytes(data)
    with pytest.raises(FileError) as error:
        mo.study(experiment(), store=store)
    refused(error, LEDGER, "an undamaged ledger")


@pytest.mark.parametrize("rest", [b"", b"this is no ledger at all, and never was one " * 99])
def test_a_lost_ledger_is_named(store, rest):
    (store / LEDGER).write_bytes(rest)
    for attempt in (lambda: mo.study(experiment(), store=store), lambda: mo.studies.StudyResult.load(store)):
        with pytest.raises(FileError) as error:
            attempt()
        refused(error, LEDGER)
    assert len(files_of(store)) == 9


def test_a_row_that_was_changed_is_found(store):
    with sqlite3.connect(store / LEDGER) as ledger:
        ledger.execute("UPDATE block SET stop = 3 WHERE part = 1 AND start = 0")
    ledger.close()
    with pytest.raises(FileError, match=r"ledger.sqlite: expected rows as they were written, got another digest of a block 1"):
        mo.study(experiment(), store=store)


def test_a_newer_format_is_refused(store):
    with sqlite3.connect(store / LEDGER) as ledger:
        ledger.execute("PRAGMA user_version = 2")
    ledger.close()
    with pytest.raises(FileError, match="expected a ledger of format 1, got format 2"):
        mo.studies.StudyResult.load(store)


def test_two_writers_are_refused_and_readers_are_not(store, finished):
    with Store(store), pytest.raises(FileError) as error:
        mo.study(experiment(), store=store)
    refused(error, store, "a store that no other study writes to", f"process {os.getpid()} on ")
    with Store(store):
        assert mo.studies.StudyResult.load(store) == finished[1]
    assert mo.study(experiment(), store=store) == finished[1]


def test_folders_that_cannot_be_used(tmp_path):
    (tmp_path / "file").write_text("x")
    for place in (tmp_path / "file", Path("/proc/none/out")):
        with pytest.raises(FileError) as error:
            mo.study(experiment(), store=place)
        refused(error, place)
    with pytest.raises(FileError, match="expected the ledger of a study, got none"):
        mo.studies.StudyResult.load(tmp_path)
    with Store(tmp_path / "begun"):
        pass
    with pytest.raises(FileError, match="expected a store with runs, got none yet"):
        mo.studies.StudyResult.load(tmp_path / "begun")


def test_a_folder_of_a_run_is_told_from_a_study(tmp_path):
    with pytest.raises(FileError) as error:
        mo.studies.StudyResult.load(tmp_path)
    refused(error, "the ledger of a study", "Of a run that is no study: mo.report")
