"""What is asked of a system that is not Linux: simulated, since the suite runs on Linux alone."""

import subprocess
import sys

import pytest
from platformdirs.macos import MacOS
from platformdirs.windows import Windows

from motes.core import kept
from motes.io import archive


@pytest.mark.parametrize("system", [MacOS, Windows])
def test_compiled_code_is_kept_where_each_system_keeps_caches(system, tmp_path, monkeypatch):
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "local"))
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv(kept.SWITCH, raising=False)
    if system is Windows:
        monkeypatch.setattr("platformdirs.windows.get_win_folder", lambda name: str(tmp_path / "local"))
    monkeypatch.setattr("platformdirs.user_cache_path", lambda name, appauthor: system(name, appauthor).user_cache_path)
    monkeypatch.setattr(kept, "POSIX", system is MacOS)
    folder = kept.private_folder("compiled")
    assert folder is not None and folder.is_dir() and folder.is_relative_to(tmp_path) and "motes" in folder.parts


def test_files_are_written_where_folders_cannot_be_opened(tmp_path, monkeypatch):
    monkeypatch.setattr(archive, "POSIX", False)
    monkeypatch.setattr("os.open", lambda *about, **more: pytest.fail("a folder was opened"))
    with archive.whole_file(tmp_path / "x") as file:
        file.write(b"1")
    assert (tmp_path / "x").read_bytes() == b"1"


def test_all_modules_can_be_imported_without_what_posix_alone_has():
    code = """
import importlib, pkgutil, sys
import jax, numpy, scipy, rich, tyro, filelock, platformdirs  # theirs know other systems
for name in ("fcntl", "pwd", "grp", "resource", "termios"):
    sys.modules[name] = None
import motes
for found in pkgutil.walk_packages(motes.__path__, "motes."):
    importlib.import_module(found.name)
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
