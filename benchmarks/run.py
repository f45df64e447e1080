"""Measures us and our peers and writes RESULTS.md, results.png and results.json beside this file; `make bench` calls it.

    python benchmarks/run.py [--quick] [--case NAME] [--out FOLDER]

A quick run, or one of a single case, writes to out/bench unless told otherwise, so that it does not replace the figures of a whole one;
with --out benchmarks a single case replaces its own figures there.
"""

import argparse
import datetime
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path

import figure
from cases import CASES, ENGINES
from problems import measurements
from report import text
from turns import HERE, Worker, compete, progress, start_up

VERSION = "import importlib.metadata as m, sys; print(*(m.version(name) for name in sys.argv[1:]))"


def installed():
    """Say which interpreter holds each package, and why where none does; see environment.py."""
    path = Path(sys.prefix) / "peers.json"
    return json.loads(path.read_text()) if path.exists() else {}


def places(found):
    """Give each engine its interpreter."""
    return {name: found.get(engine.package, {"python": sys.executable, "failed": None}) for name, engine in ENGINES.items()}


def versions(found):
    """Return the version of each package, as its own interpreter sees it."""
    known = {name: importlib.metadata.version(name) for name in ("motes", "jax", "jaxlib", "numpy")} | {"python": platform.python_version()}
    for name, place in found.items():
        done = subprocess.run([place["python"], "-c", VERSION, name, "numpy"], capture_output=True, text=True)
        version, *numpy = done.stdout.split() or [place["failed"]]
        known[name] = version if numpy in ([], [known["numpy"]]) else f"{version} (with numpy {numpy[0]})"
    return known


def machine():
    """Describe the machine in words."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())
    load = os.getloadavg()[0]
    return {"cpu": model, "cores": os.cpu_count(), "system": platform.platform(), "load before": round(load, 2)}


def write_task(folder, row):
    """Put a task with its measurements into a file, and return its path."""
    path = folder / "task.json"
    ys = [] if row.kind in ("block", "terrain") else measurements(row.model, row.steps).tolist()
    path.write_text(json.dumps({"kind": row.kind, "model": row.model, "n": row.n, "runs": row.runs, "ys": ys, **row.more}))
    return path


def measure(case, rows, python, folder, quick):
    """Measure the rows of a case; an engine that was too slow is not tried on larger rows of the same model."""
    records, workers, given_up = [], {}, {}
    for row in rows:
        progress(f"{case}: {row.kind} {row.model} {row.more or ''} n = {row.n}, {row.steps} steps")
        engines = {}
        for name in row.engines:
            reason = python[name]["failed"] or given_up.get((name, row.model))
            if reason:
                records.append(labelled(case, row, name, {"failed": reason}))
                continue
            if name not in workers or workers[name].process.poll() is not None:
                workers[name] = Worker(python[name]["python"], ENGINES[name].module, ENGINES[name].environment)
            engines[name] = (workers[name], ENGINES[name].options)
        for name, record in compete(engines, write_task(folder, row), 3 if quick else 7, 2.0 if quick else 8.0).items():
            records.append(labelled(case, row, name, record))
            if "failed" in record:
                given_up[name, row.model] = record["failed"]
            progress(f"    {name}: {record.get('failed') or min(record['seconds'], default=None)}")
    for worker in workers.values():
        worker.end()
    return records


def labelled(case, row, engine, record):
    size = row.more.get("size", 0)
    return {"case": case, "model": row.model, "size": size, "n": row.n, "steps": row.steps, "runs": row.runs, "engine": engine, **record}


def measure_starts(rows, python, folder, quick):
    """Measure cold starts: with an empty and with a filled cache, and a model built anew."""
    (row,) = rows
    task, seconds, records = write_task(folder, row), {}, []
    for turn in range(1 if quick else 3):
        for name in row.engines:
            path = str(folder / f"cache {turn} {name}")
            held = {"JAX_COMPILATION_CACHE_DIR": path, "XDG_CACHE_HOME": path, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
            tries = ((0, "empty cache", held), (0, "filled cache", held), (1, "model built anew", {"MOTES_CACHE": "off"}))
            for pick, model, settings in tries:
                reply = start_up(python[name]["python"], ENGINES[name], task, settings)
                progress(f"    {name}, {model}: {reply}")
                if isinstance(reply, str):
                    seconds[name, model] = reply
                else:
                    seconds.setdefault((name, model), []).append(reply[pick])
    for (name, model), found in seconds.items():
        record = {"failed": found} if isinstance(found, str) else {"seconds": found, "values": []}
        records.append({"case": "start", "model": model, "size": 0, "n": row.n, "steps": row.steps, "runs": 1, "engine": name, **record})
    return records


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small sizes, few repeats: to try the program out")
    parser.add_argument("--case", choices=CASES, help="measure one case only")
    parser.add_argument("--out", type=Path, help="folder of the results")
    asked = parser.parse_args()
    part = asked.quick or asked.case
    out = asked.out or (HERE.parent / "out" / "bench" if part else HERE)
    out.mkdir(parents=True, exist_ok=True)
    found = installed()
    python, today = places(found), str(datetime.date.today())
    head = {"machine": machine(), "versions": versions(found), "date": today, "quick": asked.quick}
    records, path = [], out / "results.json"
    if asked.case and path.exists():
        # ratios are formed within a case, so that one case may be measured again by itself
        records = [record for record in json.loads(path.read_text())["records"] if record["case"] != asked.case]
    with tempfile.TemporaryDirectory() as folder:
        for name in [asked.case] if asked.case else CASES:
            rows = CASES[name](asked.quick)
            if name == "start":
                records += measure_starts(rows, python, Path(folder), asked.quick)
            else:
                records += measure(name, rows, python, Path(folder), asked.quick)
            results = head | {"records": records}
            path.write_text(json.dumps(results, indent=1))
    (out / "RESULTS.md").write_text(text(results))
    figure.draw(results, out / "results.png")
    figure.bars(results, out / "bars.png")
    progress(f"wrote {out}/RESULTS.md")


if __name__ == "__main__":
    main()
