"""The program that reproduces Dahia et al. (2004), over short routes: nothing is judged here, files and tables are looked at."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest

import motes as mo
from data import recorded
from motes.applications.terrain.comparison import Rival

FOLDER = Path(__file__).parents[2] / "papers" / "dahia2004"


@pytest.fixture
def program(monkeypatch):
    """The program with small filters and short routes."""
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.delitem(sys.modules, "reproduce", raising=False)
    import reproduce

    plain = Rival(mo.ParticleFilter(n=40))
    names = ("kernel, 2500", "marginalized, 15000", "same, more noise")
    monkeypatch.setattr(reproduce, "usual_rivals", lambda model, wide: dict.fromkeys(names, plain))
    monkeypatch.setattr(reproduce, "FIRST", replace(reproduce.FIRST, fixes=20))
    for table, name in (("ROUTES", "Mont Ventoux, voids"), ("FLAT", "valley")):
        files, route = getattr(reproduce, table)[name]
        monkeypatch.setattr(reproduce, table, {name: (files, replace(route, fixes=20))})
    yield reproduce
    sys.modules.pop("reproduce", None)


@pytest.mark.night
def test_tables_and_pictures_are_written(program, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(sys, "argv", ["reproduce.py", "fifteen", "--runs", "2", "--out", str(tmp_path)])
    program.main()
    said = capsys.readouterr().out
    for position in ("0", "0.5"):
        assert f"15 states, position noise {position}\n" in said
        stem = f"15_states_position_noise_{position}"
        assert (tmp_path / f"{stem}.csv").read_text().count("\n") == 4 and (tmp_path / f"{stem}.png").stat().st_size > 10_000


@pytest.mark.night
def test_other_maps(program, monkeypatch, tmp_path, capsys):
    data = recorded("terrain/hgt/N44E005.hgt").parents[1]
    monkeypatch.setattr(sys, "argv", ["reproduce.py", "maps", "flat", "--runs", "1", "--data", str(data), "--out", str(tmp_path)])
    program.main()
    said = capsys.readouterr().out
    assert said.count("Terrain: ") == 2 and "Mont Ventoux" in said and "valley" in said
    assert len(list(tmp_path.glob("*.csv"))) == 2


@pytest.mark.parametrize(("words", "message"), [(["ten"], "part: expected one of nine"), (["maps"], "expected --data FOLDER")])
def test_words_that_mean_nothing(program, monkeypatch, capsys, words, message):
    monkeypatch.setattr(sys, "argv", ["reproduce.py", *words])
    with pytest.raises(SystemExit):
        program.main()
    assert message in capsys.readouterr().err
