"""What the Makefile asks of the machine it is on: flags that the installed JAX knows, and the newest Python."""

import sys

import pytest

import newest
import quick


@pytest.mark.night
def test_flags_that_the_installed_jax_does_not_know_are_left_out():
    unknown = "--xla_motes_knows_no_such_flag=1"
    assert not quick.stands([unknown])  # as it is to be feared: JAX ends the process
    assert quick.known([unknown, quick.FLAGS[0]]) == (quick.FLAGS[0],)
    assert quick.FLAGS[0] in quick.known() and quick.stands(quick.known())


def test_the_newest_python_runs_or_is_none(tmp_path, monkeypatch):
    found = newest.newest()
    assert found is None or newest.usable(found)
    for version in ("3.12", "3.14"):
        for name, text in (("bin", f"#!/bin/sh\nexec {sys.executable} \"$@\"\n"), ("versions", "#!/bin/sh\nexit 127\n")):
            folder = tmp_path / name / (f"{version}.1/bin" if name == "versions" else "")
            folder.mkdir(parents=True, exist_ok=True)
            (folder / f"python{version}").write_text(text)
            (folder / f"python{version}").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path))
    assert newest.newest() == str(tmp_path / "bin" / "python3.14")
    # a name on the path that cannot run, as those of pyenv for versions that are not switched on, is passed over
    (tmp_path / "bin" / "python3.14").write_text("#!/bin/sh\nexit 127\n")
    assert newest.newest() == str(tmp_path / "bin" / "python3.12")
    monkeypatch.setenv("PATH", str(tmp_path / "nowhere"))
    assert newest.newest() is None
