"""Reproduces Karlsson, Schon, Gustafsson (2005): figures 1 to 3 and tables II and III, on this machine.

    python papers/karlsson2004/reproduce.py [figure1 figure2 figure3 table2 table3 tracks] [--runs 100] [--engine native] [--quick]

Numbers and pictures go to out/karlsson2004. All of it takes some thirty minutes; leave the machine alone meanwhile. A quick run has few
runs and partitions: it tries the program out, and its numbers mean nothing.
"""

import argparse
import os
import platform
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")

import clock
import ratios
import scenario
import tables
import times
from printed import FULL, KALMAN, PLAIN, TABLE_II, TABLE_III

import motes as mo
from motes.io.archive import provenance

PARTS = ("figure1", "figure2", "figure3", "table2", "table3", "tracks")
ENGINES = ("jax", "native")
SCENARIOS = ("short", "close", "long")
TURNS = 8
PRECISION = 0.05


def options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Reproduces Karlsson, Schon, Gustafsson (2005).")
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; all if none is named")
    parser.add_argument("--runs", type=int, default=100, help="sets of measurements (100)")
    parser.add_argument("--engine", choices=ENGINES, help="the one to measure; both if not given")
    parser.add_argument("--out", type=Path, default=Path("out/karlsson2004"), help="folder of the results")
    parser.add_argument("--quick", action="store_true", help="try the program out")
    given = parser.parse_args()
    for part in given.parts:
        if part not in PARTS:
            parser.error(f"part: expected one of {', '.join(PARTS)}, got {part!r}")
    return given


def usable(engines: Sequence[str]) -> list[str]:
    """Return the engines that this machine has, and say so where the native one is missing."""
    if "native" not in engines:
        return list(engines)
    plan = scenario.experiment("short", {FULL: TABLE_II[FULL][0]}, 1)
    with mo.engine("native"):
        did = mo.run(0, plan.filters[FULL], plan.model, plan.drawn(0)[1]).engine
    if did != "native":
        print(f"engine native: not here (its run was done by {did})")
    return [name for name in engines if name in ("jax", did)]


def results(given: argparse.Namespace) -> Iterator[str]:
    """Do what was asked for, and give what to print."""
    parts, quick, out = given.parts or PARTS, given.quick, given.out
    runs, turns = (8, 1) if quick else (given.runs, TURNS)
    # the two ends of the search of table III are all that a quick run tries
    precision, n = (float("inf"), TABLE_II[PLAIN][0]) if quick else (PRECISION, TABLE_III[PLAIN][0])
    partitions = (PLAIN, FULL) if quick else tuple(KALMAN)
    matched = cache(lambda: clock.matched(partitions, TABLE_II[PLAIN][0], turns))
    if "figure1" in parts:
        yield ratios.reproduce("figure1", ratios.FIGURE_1, out)
    if "figure2" in parts:
        yield ratios.reproduce("figure2", ratios.FIGURE_2, out)
    engines = usable([given.engine] if given.engine else ENGINES) if set(parts) - {"figure1", "figure2"} else []
    for engine in engines:
        matched.cache_clear()
        with mo.engine(engine):
            if "figure3" in parts:
                yield times.reproduce(engine, partitions, turns, quick, out)
            for place in SCENARIOS if "table2" in parts else ():
                yield saved(f"table2_{place}_{engine}", tables.table_2(place, matched(), runs), out)
            for place in SCENARIOS[: 1 if quick else 2] if "table3" in parts else ():
                table = tables.table_3(scenario.experiment(place, dict.fromkeys(partitions, n), runs), turns, precision)
                yield saved(f"table3_{place}_{engine}", table, out)
            if "tracks" in parts and engine == engines[-1]:
                yield tables.tracks(matched(), runs, 3 if quick else scenario.TRACKS, out)


def saved(name: str, table: mo.io.Table, out: Path) -> str:
    """Save a table as CSV and Markdown, and return it with its name."""
    table.save(out / f"{name}.csv")
    table.save(out / f"{name}.md")
    return f"{name}\n{table}"


def main() -> None:
    """Print and keep the results."""
    given = options()
    given.out.mkdir(parents=True, exist_ok=True)
    facts = provenance() | {"system": platform.platform(), "processors": f"1 of {os.cpu_count()}", "load": f"{os.getloadavg()[0]:.1f}"}
    print(", ".join(f"{name} {value}" for name, value in facts.items()), flush=True)
    for text in results(given):
        print(f"\n{text}", flush=True)


def keep_to_one_processor() -> None:
    """Use one processor, as the paper had: with more, times jump where filters begin to share their work out, and with the load."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


if __name__ == "__main__":
    keep_to_one_processor()
    main()
