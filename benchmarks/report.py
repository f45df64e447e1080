"""Turns results.json into RESULTS.md and a plot. Nothing is measured here."""

import math
import statistics
from collections.abc import Iterator

from cases import OURS
from targets import SLOPE, TARGETS

TITLES = {
    "bootstrap": "Bootstrap filter",
    "models": "Models with substeps, tables and maps",
    "marginalized": "Marginalized filter",
    "many": "100 runs of 2 000 particles",
    "kalman": "Kalman filter",
    "scaling": "Cost against particles and steps",
    "start": "Cold start",
    "blocks": "Building blocks",
}
NOTES = {
    "bootstrap": "Nanoseconds per particle and step; systematic resampling at every step, 100 steps. Kept of each step: evidence and ESS "
    "(motes, particles, smcx, yardstick), mean and covariance too where the row says so, evidence alone by cuthbert and Stone Soup. "
    "particles and Stone Soup compute in float64, all others in float32 but where the row says so. Every engine filters the same "
    "measurements: that the log likelihoods agree shows that all do the same work. The NumPy libraries have one BLAS thread, which is "
    "their faster setting.",
    "models": "Nanoseconds per particle and step. Pendulums: ten substeps by Runge and Kutta and a table of 400 x 400 looked up by every "
    "particle, bootstrap filter, 50 steps. Terrain: the demo, 400 fixes over real relief, marginalized and kernel filter.",
    "marginalized": "Nanoseconds per particle and step; radar: one covariance recursion for all particles; turning: one for each particle "
    "(two particle states, four Kalman states, two measured components).",
    "many": "Nanoseconds per particle, step and run, radar model; the log likelihood is the mean over the runs. The JAX libraries map over "
    "keys with `vmap`, particles has its `multiSMC` on all cores.",
    "kalman": "Nanoseconds per step; four states, two measured. The NumPy libraries take a shorter record.",
    "scaling": "Nanoseconds per particle and step; radar model. The target of the longer records flies a circle, so that it stays.",
    "start": "Seconds from the start of a fresh process to the end of its first run (2 000 particles, 100 steps, radar), with an empty and "
    "with a filled compilation cache; 'model built anew' is a second run, on a model made of fresh functions, in a process without cache.",
    "blocks": "Nanoseconds per number or small matrix (size x size), each timing 20 calls; the value is the mean of all entries of the "
    "result, or the standard deviation of the normal numbers.",
}


MINE = (OURS, ("motes.core",))
"""The engines of ours that others are compared with: filters, building blocks."""


def measured(records: list[dict]) -> Iterator[dict]:
    """Yield the records that have times."""
    return (record for record in records if record.get("seconds"))


def unit(record: dict) -> float:
    """Give what a second counts for in a record's case: nanoseconds per particle, step and run; plain seconds for cold starts."""
    return 1.0 if record["case"] == "start" else 1e9 / (record["n"] * record["steps"] * record["runs"])


def typical(record: dict) -> float:
    """Give the median cost of a record."""
    return statistics.median(record["seconds"]) * unit(record)


def short(value: float) -> str:
    """Write a number with three digits."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def rows_of(records: list[dict]) -> dict[tuple, list[dict]]:
    """Group the records of one case by what was run."""
    rows: dict[tuple, list[dict]] = {}
    for record in records:
        rows.setdefault((record["model"], record["size"], record["n"], record["steps"]), []).append(record)
    return rows


def table(head: tuple[str, ...], lines: list[tuple[str, ...]]) -> str:
    """Write a Markdown table."""
    return "\n".join("| " + " | ".join(line) + " |" for line in (head, ("---",) * len(head), *lines))


def values(record: dict, reference: dict | None) -> str:
    """Write the log likelihoods of a record: mean, spread of one run, and a mark where they differ by more than chance (five sigma)."""
    found = record["values"]
    if not found:
        return ""
    mean, spread = statistics.fmean(found), statistics.stdev(found) if len(found) > 1 else 0.0
    text = f"{mean:.6g}" + (f" (sd {spread:.2g})" if spread else "")
    if reference and reference is not record and len(found) > 2 and len(reference["values"]) > 2:
        other = reference["values"]
        allowed = 5 * math.sqrt(spread**2 / len(found) + statistics.variance(other) / len(other)) + 1e-4 * abs(mean)
        if abs(mean - statistics.fmean(other)) > allowed:
            text += " **differs**"
    return text


def case_table(records: list[dict]) -> str:
    """Write the table of one case: each row's engines with their medians, ranges, ratios and log likelihoods."""
    lines = []
    for (model, size, n, steps), row in rows_of(records).items():
        name = f"{model}, {size} x {size}" if size > 1 else model
        own = {record["engine"]: typical(record) for record in measured(row) if "motes" in record["engine"]}
        reference = next(measured(row), None)
        for record in row:
            start = (name, f"{n:,}", f"{steps:,}", record["engine"])
            if not record.get("seconds"):
                lines.append((*start, record.get("failed", "not run"), "", "", "", ""))
                continue
            low, high = (short(pick(record["seconds"]) * unit(record)) for pick in (min, max))
            first = f"{record['first']:.1f}" if "first" in record else ""
            ratios = " / ".join(f"{typical(record) / own[mine]:.2f}" if mine in own else "-" for mine in MINE[record["case"] == "blocks"])
            lines.append((*start, short(typical(record)), f"{low} to {high}", ratios, first, values(record, reference)))
    ours = "times ours (as it comes / JAX / native)"
    head = ("task", "n", "steps", "engine", "median", "range", ours, "first, s", "log likelihood or value")
    return table(head, lines)


def target_table(records: list[dict]) -> str:
    """Write what was asked beside what was measured."""
    found = {(r["case"], r["model"], r["size"], r["n"], r["steps"], r["engine"]): typical(r) for r in measured(records)}
    lines = []
    for target in TARGETS:
        asked = (target.case, target.model, target.size, target.n, target.steps)
        slow, fast = (found.get((*asked, engine)) for engine in (target.slow, target.fast))
        words = f"{target.case}, {target.model}{f' {target.size} x {target.size}' if target.size > 1 else ''}, n = {target.n:,}"
        limit = f"{'<=' if target.most else '>='} {target.factor:g}"
        ratio = slow / fast if slow and fast else None
        met = "" if ratio is None else "yes" if (ratio <= target.factor) == target.most else "**no**"
        lines.append((words, f"{target.slow} / {target.fast}", limit, f"{ratio:.2f}" if ratio else "not measured", met))
    for engine in OURS[1:]:
        for words, axis, fixed in (("particles", "n", "steps"), ("steps", "steps", "n")):
            slope = slope_of(records, engine, axis, fixed)
            met = "" if slope is None else "yes" if SLOPE[0] <= slope <= SLOPE[1] else "**no**"
            lines.append((f"exponent of time against {words}", engine, "1.0 +- 0.1", f"{slope:.3f}" if slope else "not measured", met))
    return table(("case", "ratio of times", "asked", "measured", "met"), lines)


def slope_of(records: list[dict], engine: str, axis: str, fixed: str) -> float | None:
    """Fit the exponent of time against particles or steps, over the rows that share the other."""
    mine = [record for record in measured(records) if record["case"] == "scaling" and record["engine"] == engine]
    common = statistics.mode(record[fixed] for record in mine) if mine else None
    points = {record[axis]: statistics.median(record["seconds"]) for record in mine if record[fixed] == common}
    if len(points) < 2:
        return None
    x, y = [math.log(size) for size in points], [math.log(seconds) for seconds in points.values()]
    return statistics.linear_regression(x, y).slope


def losses(records: list[dict]) -> list[str]:
    """List in words each engine that beats ours on a row."""
    found = []
    for case in TITLES:
        for (model, size, n, steps), row in rows_of([record for record in records if record["case"] == case]).items():
            cost = {record["engine"]: typical(record) for record in measured(row)}
            for mine in MINE[case == "blocks"]:
                ahead = [(other, cost[mine] / cost[other]) for other in cost if mine in cost and "motes" not in other]
                what = f"{case}, {model}{f' {size} x {size}' if size > 1 else ''}, n = {n:,}, {steps:,} steps"
                found += [f"{what}: {other} is {ratio:.2f} times as fast as {mine}" for other, ratio in ahead if ratio > 1]
    return found


def text(results: dict) -> str:
    """Write the whole report."""
    records, machine = results["records"], results["machine"]
    quick = " **A quick run: small sizes, few repeats; read no figures from it.**" if results["quick"] else ""
    parts = [
        "# Our figures beside the peers'",
        f"Written by `make bench` on {results['date']}.{quick} {machine['cpu']}, {machine['cores']} cores, {machine['system']}; "
        f"load before: {machine['load before']}. Engines run in turns, each in its own process, never two at once; medians of warm runs.",
        "Versions: " + ", ".join(f"{name} {version}" for name, version in results["versions"].items()) + ".",
        "What each of our filters costs beside its operations: [FILTERS.md](FILTERS.md).",
        "Effective draws per second of Markov chains, beside blackjax and emcee: [CHAINS.md](CHAINS.md).",
        "## Asked and measured",
        target_table(records),
        "## Where we lose",
        "\n".join(f"* {line}" for line in losses(records)) or "Nowhere in this run.",
    ]
    for case, title in TITLES.items():
        mine = [record for record in records if record["case"] == case]
        if mine:
            parts += [f"## {title}", NOTES[case], case_table(mine)]
    return "\n\n".join(parts) + "\n"
