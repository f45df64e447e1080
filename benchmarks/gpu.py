"""Runs the cases on an accelerator, checks them against the CPU and writes GPU.md beside this file.

    python benchmarks/gpu.py [--dry] [--out FOLDER]

Every case runs on the JAX engine, on the device and on the CPU of the same machine, in a process for each; beside them on the CPU with the
native engine, where a compiler stands. Medians of warm runs. Random numbers and the first steps are held against the CPU's, log likelihoods
of whole runs by five standard errors, since ancestors differ where a cumulative weight falls on a rounding.
`--dry` takes the CPU for the device, and small sizes: to try the program out.
"""

import argparse
import datetime
import json
import math
import statistics
import sys
import tempfile
from pathlib import Path

import numpy as np
from cases import Row
from problems import measurements
from report import short, table
from run import machine
from turns import HERE, Worker, compete, progress

TARGET = 5e9
"""Particle-steps per second asked of the radar filter with ten million particles on one H100."""
TRAFFIC = 72
"""Bytes per particle and step that no filter of six float32 states can do without: the states read and written, the two that are measured
read again, weights and ancestors written and read."""
STEPS = ("log likelihood, one step", "log likelihood, two steps, resampled between")
LIMITS = {"normal numbers, units in the last place": 4, "children beyond n w": 1.01, "mean, in standard deviations": 1e-5,
          "covariance, relative": 1e-5, STEPS[0]: 2e-5, STEPS[1]: 1e-3}  # fmt: skip
"""The largest difference from the CPU (from float64 and from n w in the three in the middle) that counts as agreement. Ends of shares are
right to about 1e-3 children, so that after resampling a few particles in a thousand may have a neighbor's ancestor: of 100 000 particles, a
tenth of the sampling error or so."""
MOST, MOST_ON_CPU = 10_000_000, 2e8
ENGINES = ("device", "CPU", "CPU, native")
DOUBLE = {"JAX_ENABLE_X64": "1"}
BY_NAME = {"XLA_FLAGS": "--xla_gpu_enable_command_buffer="}
"""The profiler knows which operation a kernel belongs to only where kernels are launched one by one."""


def rows(dry):
    """List what is measured: a name beside the task, and the variables of its processes."""
    if dry:
        small = Row("bootstrap", "radar", 500, 5, ENGINES[:2])
        return [("radar", small, {}), ("radar, float64", small, DOUBLE), ("Kalman", Row("kalman", "track", 1, 20, ENGINES[:2]), {})]
    return [
        *(("radar", Row("bootstrap", "radar", n, 100, ENGINES), {}) for n in (2_000, 200_000, 1_000_000, MOST)),
        ("radar, mean and covariance", Row("bootstrap", "radar", MOST, 100, ENGINES, more={"keep": "moments"}), {}),
        ("radar, float64", Row("bootstrap", "radar", 1_000_000, 100, ENGINES[:2]), DOUBLE),
        *(("line", Row("bootstrap", "line", n, 100, ENGINES), {}) for n in (1_000_000, MOST)),
        ("radar, many runs", Row("many", "radar", 2_000, 100, ENGINES, runs=100), {}),
        *((f"marginalized, {model}", Row("marginalized", model, 200_000, 100, ENGINES), {}) for model in ("radar", "turning")),
        ("Kalman", Row("kalman", "track", 1, 10_000, ENGINES[:2]), {}),
    ]


class Processes:
    """Processes of the device and of the CPU, kept alive; of those on the device one at a time, since it takes most of its memory."""

    def __init__(self, dry, folder):
        """Take the CPU for the device in a dry run; tasks go to the folder."""
        self.dry, self.folder = dry, folder
        self.alive = {}

    def worker(self, engine, variables):
        """Return the process of an engine, and end those on the same device that have other variables."""
        place = (engine, tuple(variables))
        for other in [other for other in self.alive if other[0] == engine and other != place]:
            self.alive.pop(other).end()
        if place not in self.alive or self.alive[place].process.poll() is not None:
            platforms = "cuda,cpu" if engine == "device" and not self.dry else "cpu"
            self.alive[place] = Worker(sys.executable, "device", {"JAX_PLATFORMS": platforms, **variables})
        return self.alive[place]

    def end(self):
        """End all."""
        for worker in self.alive.values():
            worker.end()

    def ask(self, engine, task, variables={}):  # noqa: B006
        """Return one answer of peers/device.py.

        Raises:
            RuntimeError: there is none.
        """
        worker = self.worker(engine, variables)
        for order in ({"do": "prepare", "task": self.written(task | {"name": engine}), "options": {}}, {"do": "run", "seed": 0}):
            reply = worker.ask(order, 300)
            if "failed" in reply:
                raise RuntimeError(f"{task['kind']} on {engine}: {reply['failed']}")
        return reply["value"]

    def written(self, task):
        """Put a task into a file, and return its path."""
        path = self.folder / "task.json"
        path.write_text(json.dumps(task | {"folder": str(self.folder)}))
        return str(path)

    def measured(self, row, variables):
        """Measure a row in turns, on the CPU where that can be expected to end within a minute; see `turns.compete`."""
        task = {"kind": row.kind, "model": row.model, "n": row.n, "runs": row.runs, "ys": measurements(row.model, row.steps).tolist()}
        engines = {}
        for engine in row.engines:
            if engine == "device" or row.n * row.steps * row.runs <= MOST_ON_CPU:
                options = {"engine": "native" if "native" in engine else "jax", **row.more}
                engines[engine] = (self.worker(engine, variables), options)
        found = compete(engines, self.written(task), 2 if self.dry else 7, 3.0)
        progress(f"    {found}")
        return found


def agreement(device, cpu):
    """Compare log likelihoods of two engines: in standard errors of their difference, or relative where nothing is drawn."""
    if not device.get("values") or not cpu.get("values"):
        return ""
    ours, theirs = device["values"], cpu["values"]
    apart = abs(statistics.fmean(ours) - statistics.fmean(theirs))
    spread = math.sqrt(statistics.pvariance(ours) / len(ours) + statistics.pvariance(theirs) / len(theirs))
    close = apart <= 1e-4 * abs(statistics.fmean(theirs))
    return f"{apart:.2g}, " + ("agrees" if close or apart <= 5 * spread else "**differs**")


def cases(processes):
    """Measure all rows; lines of the table, and what the largest radar filter reached."""
    lines, reached, largest = [], 0.0, 0
    for name, row, variables in rows(processes.dry):
        progress(f"{name} n = {row.n}")
        found = processes.measured(row, variables)
        size, device = row.n * row.steps * row.runs, found["device"]
        start = (name, f"{row.n:,}", f"{row.steps:,}")
        if not device.get("seconds"):
            lines.append((*start, device.get("failed", "not run"), *[""] * 7))
            continue
        cost = {engine: statistics.median(record["seconds"]) for engine, record in found.items() if record.get("seconds")}
        others = (f"{cost[engine] / cost['device']:.3g}" if engine in cost else "" for engine in ENGINES[1:])
        if name == "radar" and row.n > largest:
            reached, largest = size / cost["device"], row.n
        speed = (short(1e9 * cost["device"] / size), f"{size / cost['device']:.2e}", short(1e3 * cost["device"] / row.steps))
        value = f"{statistics.fmean(device['values']):.6g}"
        lines.append((*start, *speed, *others, f"{device['first']:.1f}", value, agreement(device, found.get("CPU", {}))))
    return lines, reached


def same(processes, n):
    """Compare random numbers, resampling, moments and the first steps of a run; lines of the table."""
    device, cpu = (processes.ask(engine, {"kind": "stream", "n": n}) for engine in ENGINES[:2])
    lines = [(name, "equal" if device[name] == cpu[name] else "**differ**", "equal") for name in ("random words", "uniform numbers")]
    ours, theirs = (np.load(found["normals"]).view(np.int32).astype(np.int64) for found in (device, cpu))
    lines.append(("normal numbers that are equal to the bit", f"{np.mean(ours == theirs):.1%}", ""))
    apart = {name: np.max(np.abs(ours - theirs)) if "normal" in name else device.get(name) for name in LIMITS}
    for steps, name in enumerate(STEPS, 1):
        found = processes.measured(Row("bootstrap", "radar", min(n, 100_000), steps, ENGINES[:2]), {})
        pairs = zip(found["device"]["values"], found["CPU"]["values"], strict=False)
        apart[name] = max(abs(one - other) for one, other in pairs)
    limits = {name: (f"{value:.2g}" + ("" if value <= LIMITS[name] else " **too much**"), LIMITS[name]) for name, value in apart.items()}
    return [*lines, *((name, value, f"<= {limit:g}") for name, (value, limit) in limits.items())]


def page(facts, reached, parts):
    """Put the page together."""
    bound = facts["bytes"] / TRAFFIC
    met = "met" if reached >= TARGET else "not met"
    return "\n\n".join([
        "# On an accelerator",
        f"Written by `python benchmarks/gpu.py` on {datetime.date.today()}{facts['dry']}. Device: {facts['device']}, jax {facts['jax']}; "
        f"the CPU beside it: {facts['cpu']}. Float32 and systematic resampling at every step where nothing else is said.",
        __doc__.split("\n\n")[2].strip(),
        f"**Radar filter with {facts['n']:,} particles: {reached:.2e} particle-steps per second; asked on one H100: {TARGET:.0e}, {met}.** "
        f"Memory is read and written at {facts['bytes'] / 1e12:.2f} TB/s, and a step moves at least {TRAFFIC} bytes for a particle: "
        f"{bound:.1e} would be the end.",
        "## Cases",
        "Times of the CPU beside those of the device: how many times as long the same run takes. No figure: it would take minutes.",
        table(("case", "n", "steps", "ns per particle and step", "particle-steps per s", "ms per step", "CPU, JAX", "CPU, native",
               "first run, s", "log likelihood", "apart from the CPU's"), parts["cases"]),  # fmt: skip
        "## The same numbers",
        table(("what", "found", "asked"), parts["same"]),
        "## Where the time of a step goes",
        f"Radar, {facts['n']:,} particles, by the profiler, kernels launched one by one. A kernel that does the work of two stages counts "
        "as both together.",
        table(("stage", "ms per step", "share", "kernels per step"), parts["profile"]),
    ]) + "\n"  # fmt: skip


def profile(processes, n, steps):
    """Profile the radar filter; lines of the table."""
    task = {"kind": "profile", "model": "radar", "n": n, "ys": measurements("radar", steps).tolist()}
    found = processes.ask("device", task, {} if processes.dry else BY_NAME)
    whole = [sum(column) for column in list(zip(*found, strict=True))[1:]]
    shown = [one for one in found if one[1] >= 0.01 * whole[0]]
    rest = [total - sum(one[i] for one in shown) for i, total in enumerate(whole, 1)]
    lines = [*shown, ("the rest", *rest), ("sum", *whole)]
    return [(stage, f"{spent:.3f}", f"{spent / whole[0]:.0%}", f"{count:.1f}") for stage, spent, count in lines]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dry", action="store_true", help="the CPU for the device, small sizes")
    parser.add_argument("--out", type=Path, help="folder of the page; a dry run writes to out/bench unless told otherwise")
    asked = parser.parse_args()
    out = asked.out or (HERE.parent / "out" / "bench" if asked.dry else HERE)
    out.mkdir(parents=True, exist_ok=True)
    n = 500 if asked.dry else MOST
    with tempfile.TemporaryDirectory() as folder:
        processes = Processes(asked.dry, Path(folder))
        try:
            facts = processes.ask("device", {"kind": "speed", "n": n})
            facts |= {"n": n, "cpu": "{cpu}, {cores} cores".format(**machine()), "dry": ", **a dry run: read no figures**" * asked.dry}
            parts = {"same": same(processes, n)}
            parts["cases"], reached = cases(processes)
            parts["profile"] = profile(processes, n, 5 if asked.dry else 20)
        finally:
            processes.end()
    text = page(facts, reached, parts)
    (out / "GPU.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
