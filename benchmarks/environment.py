"""Builds the environments of the benchmarks: one for us and most peers, one for each peer that asks for an older NumPy.

    python benchmarks/environment.py FOLDER

A peer that cannot be installed is no error: its reason goes to FOLDER/peers.json and from there into the results.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path

PEERS = {"particles": "apart", "smcx": "", "cuthbert": "", "filterpy": "", "dynamax": "", "stonesoup": "", "blackjax": "", "emcee": ""}
"""Name in the registry, and the environment of its own that it needs, if any: with NumPy 2 one would get an old `particles`."""

OTHERS = ("opencv-contrib-python-headless",)
"""Installed beside us, too, for the scripts that stand apart: they go without one that cannot be installed."""

TOGETHER = ("jax>=0.10", "numpy>=2")
"""What a peer beside us must leave as it is."""


def created(folder, base):
    """Make an empty environment if there is none, and return its interpreter."""
    python = folder / "bin" / "python"
    if not python.exists():
        uv = shutil.which("uv")
        command = [uv, "venv", "-q", "--python", base, str(folder)] if uv else [base, "-m", "venv", str(folder)]
        subprocess.run(command, check=True)
    return python


def install(python, *wanted):
    """Install into an environment; return None, or in one line why it failed."""
    uv = shutil.which("uv")
    start = [uv, "pip", "install", "-q", "--python", str(python)] if uv else [str(python), "-m", "pip", "install", "-q"]
    done = subprocess.run([*start, *wanted], capture_output=True, text=True)
    if done.returncode == 0:
        return None
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    return f"could not be installed: {lines[-1] if lines else 'no reason given'}"[:200]


def main(folder):
    together = created(folder, sys.executable)
    root = Path(__file__).parents[1]
    failed = install(together, "-e", f"{root}[video]", "matplotlib")
    if failed:
        sys.exit(failed)
    for name in OTHERS:
        print(f"installing {name}", install(together, name, *TOGETHER) or "", file=sys.stderr)
    found = {}
    for name, place in PEERS.items():
        print(f"installing {name}", file=sys.stderr)
        python = created(folder / place, sys.executable) if place else together
        found[name] = {"python": str(python), "failed": install(python, name, *(() if place else TOGETHER))}
    (folder / "peers.json").write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main(Path(sys.argv[1]).absolute())
