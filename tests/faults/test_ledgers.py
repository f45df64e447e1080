"""Ledgers that are not ours, or newer, are refused before anything touches them; a full disk is no damage."""

import sqlite3

import pytest
from told import refusal

from motes.studies.ledger import SCHEMA, sound
from motes.studies.store import LEDGER, Store

# stores --------------------------------------------------------------------------------------------------------------

LEDGERS = {
    "newer": SCHEMA.replace("user_version = 1", "user_version = 2"),
    "foreign": "CREATE TABLE x (a); INSERT INTO x VALUES (1);",
    "foreign with our number": "CREATE TABLE x (a); PRAGMA user_version = 1;",
    "trigger": SCHEMA + "CREATE TRIGGER t AFTER INSERT ON block BEGIN DELETE FROM block; END;",
    "view": SCHEMA + "CREATE VIEW v AS SELECT 1;",
    "another table": SCHEMA + "CREATE TABLE more (a);",
    "another column": SCHEMA.replace("stop INTEGER,", "stop INTEGER, more TEXT,"),
}


@pytest.mark.parametrize("mode", ["DELETE", "WAL"])
@pytest.mark.parametrize("name", LEDGERS)
def test_ledgers_of_others_are_refused_and_left_as_they_are(tmp_path, name, mode):
    ledger = sqlite3.connect(tmp_path / LEDGER)
    ledger.execute(f"PRAGMA journal_mode={mode}")
    ledger.executescript(LEDGERS[name])
    ledger.commit()
    ledger.close()
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for write in (True, False):
        refusal(lambda write=write: Store(tmp_path, write=write), LEDGER)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_ledgers_of_ours_are_taken_whatever_the_moment_they_were_left_at(tmp_path):
    for number, script in enumerate(("", SCHEMA)):
        folder = tmp_path / str(number)
        folder.mkdir()
        ledger = sqlite3.connect(folder / LEDGER)
        ledger.execute("PRAGMA journal_mode=WAL")
        ledger.executescript(script)
        left = {path.name: path.read_bytes() for path in folder.iterdir()}
        ledger.close()
        for name, data in left.items():
            (folder / name).write_bytes(data)
        (folder / f"{LEDGER}-shm").unlink(missing_ok=True)
        with Store(folder) as store:
            assert store.parts() == {}


def test_a_full_disk_is_no_damage(tmp_path):
    ledger = sqlite3.connect(tmp_path / LEDGER)
    ledger.executescript(SCHEMA + "PRAGMA max_page_count = 8;")

    def fill():
        with sound(tmp_path / LEDGER, "an undamaged ledger"):
            for number in range(1000):
                ledger.execute("INSERT INTO field VALUES (?, ?, '', '')", (str(number), "x" * 500))

    refusal(fill, LEDGER, "a disk with room", "full", "SQLITE_FULL")
