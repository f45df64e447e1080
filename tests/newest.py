"""Finds the newest Python on this machine that JAX may be newer on than on ours; run as a program it prints its path, or nothing."""

import os
import shutil
import subprocess
from pathlib import Path

VERSIONS = ("3.14", "3.13", "3.12")


def candidates(version):
    """Interpreters of one version: the one on the path, then those of pyenv, whose names on the path only work where it is told so."""
    found = shutil.which(f"python{version}")
    root = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv")
    return [*([found] if found else []), *map(str, sorted(root.glob(f"versions/{version}.*/bin/python{version}"), reverse=True))]


def usable(python):
    """Whether it runs, and can make environments."""
    return not subprocess.run([python, "-c", "import ensurepip, venv"], capture_output=True).returncode


def newest():
    """Return the path of the newest one that is usable, or None."""
    return next((python for version in VERSIONS for python in candidates(version) if usable(python)), None)


if __name__ == "__main__":
    print(newest() or "")
