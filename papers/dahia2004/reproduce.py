"""Reproduces Dahia, Musso, Pham, Guibert (2004) on real relief: who loses fewer runs, and how near to the bound the others come.

    python papers/dahia2004/reproduce.py [nine fifteen equal maps flat] [--runs 100] [--data FOLDER]

Tables and pictures go to out/dahia2004. All of it takes an hour and a half with MOTES_ENGINE=native, most of it for `maps` and `flat`;
leave the machine alone meanwhile. These two need elevation files: FOLDER holds dted/w122/n36.dt1, dted/w121/n36.dt1, hgt/N44E005.hgt and
geotiff/srtm_bigtujunga30m_utm11.tif.
"""

import argparse
import os
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")

import numpy as np

import motes as mo
from motes.applications.terrain import scenario
from motes.applications.terrain.comparison import Comparison, Rival, compare, usual_rivals
from motes.applications.terrain.pictures import comparison_figure
from motes.applications.terrain.roughness import roughness
from motes.applications.terrain.settings import FIRST, Inertial, Noises, Route
from motes.io.archive import provenance
from motes.io.rasters import mosaic, read_raster
from motes.models.terrain import TerrainMap, terrain_map

PARTS = ("nine", "fifteen", "equal", "maps", "flat")
SEED = 1000
"""Flights are SEED, SEED + 1, ...; no setting of a filter was chosen on them."""
TILES = ("dted/w122/n36.dt1", "dted/w121/n36.dt1")
VENTOUX, TUJUNGA = "hgt/N44E005.hgt", "geotiff/srtm_bigtujunga30m_utm11.tif"
ROUTES = {
    "coast range": (TILES, Route(north=20_000, east=50_000, heading=45)),
    "seam of two tiles": (TILES, Route(north=30_000, east=75_000, heading=90)),
    "Mont Ventoux, voids": ((VENTOUX,), Route(north=30_000, east=20_000, heading=45)),
    "Big Tujunga, UTM": ((TUJUNGA,), Route(north=4_000, east=3_000, heading=75)),
}
FLAT = {"valley": (TILES, Route(north=60_000, east=160_000, heading=0)), "sea": (TILES, Route(north=40_000, east=5_000, heading=0))}


def options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Reproduces Dahia, Musso, Pham, Guibert (2004).")
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; all if none is named")
    parser.add_argument("--runs", type=int, default=100, help="flights (100)")
    parser.add_argument("--data", type=Path, help="folder of elevation files, for maps and flat")
    parser.add_argument("--out", type=Path, default=Path("out/dahia2004"), help="folder of the results")
    given = parser.parse_args()
    for part in given.parts:
        if part not in PARTS:
            parser.error(f"part: expected one of {', '.join(PARTS)}, got {part!r}")
    if given.data is None and {"maps", "flat"} & set(given.parts):
        parser.error("maps and flat: expected --data FOLDER with elevation files, got none")
    return given


def fleet(runs: int, terrain: TerrainMap | None, route: Route, position: float, states: int = 9) -> list[scenario.Flight]:
    """Simulate flights over one true track, each with inertial errors of its own."""
    kind, noises = Inertial(states=states), Noises(position=position)
    return [scenario.simulated(SEED + k, terrain, route, noises, kind=kind) for k in range(runs)]


def rivals(flights: list[scenario.Flight], terrain: TerrainMap | None, route: Route, states: int = 9) -> dict[str, Rival]:
    """Return the filters of the paper, and the marginalized one that believes in position noise of 2 m/sqrt(s)."""
    wide = scenario.simulated(SEED, terrain, route, Noises(position=2.0), kind=Inertial(states=states)).model
    return usual_rivals(flights[0].model, wide)


def write(name: str, found: Comparison, seconds: np.ndarray, folder: Path) -> None:
    """Print a comparison; write its table and the picture of its errors."""
    print(f"\n{name}\n{found.table}", flush=True)
    stem = "_".join(name.replace(",", "").split())
    found.table.save(folder / f"{stem}.csv")
    comparison_figure(seconds, found.curves, name).savefig(folder / f"{stem}.png")


def over_jacksboro(states: int, positions: tuple[float, ...], runs: int, folder: Path) -> None:
    """Compare filters over the map that matplotlib ships."""
    for position in positions:
        flights = fleet(runs, None, FIRST, position, states)
        found = compare(flights, rivals(flights, None, FIRST, states))
        write(f"{states} states, position noise {position:g}", found, flights[0].seconds, folder)


def at_equal_time(runs: int, folder: Path) -> None:
    """Give the marginalized filter the time of the kernel filter."""
    flights = fleet(runs, None, FIRST, 2.0)
    first = flights[0]
    usual = rivals(flights, None, FIRST)
    kernel = usual["kernel, 2500"].filter
    budget = mo.costs.seconds_per_step(kernel, first.model, first.ys, first.inputs)
    pilot = mo.planning.Pilot(runs=8, inputs=first.inputs, filters={"marginalized": mo.MarginalizedParticleFilter(n=1)})
    marginalized = mo.plan(first.model, budget, states=("rN", "rE"), pilot=pilot).choice
    found = compare(flights, {"kernel, 2500": Rival(kernel), f"marginalized, {marginalized.n}": Rival(marginalized)})
    write("equal time, position noise 2", found, first.seconds, folder)


def over(routes: dict[str, tuple[tuple[str, ...], Route]], runs: int, data: Path, folder: Path) -> None:
    """Compare filters over other maps, the roughness of each track beside them."""
    for name, (files, route) in routes.items():
        terrain = terrain_map(mosaic([read_raster(data / file) for file in files]))
        flights = fleet(runs, terrain, route, 0.5)
        print(f"\n{roughness(flights[0].model, flights[0].inputs)}")
        usual = rivals(flights, terrain, route)
        found = compare(flights, {one: usual[one] for one in ("kernel, 2500", "marginalized, 15000", "same, more noise")})
        write(name, found, flights[0].seconds, folder)


def main() -> None:
    """Reproduce what was asked for."""
    given = options()
    given.out.mkdir(parents=True, exist_ok=True)
    print(", ".join(f"{key.removeprefix('motes_')} {value}" for key, value in provenance().items()))
    wanted = given.parts or (PARTS if given.data else PARTS[:3])
    if "nine" in wanted:
        over_jacksboro(9, (0.5, 2.0), given.runs, given.out)
    if "fifteen" in wanted:
        over_jacksboro(15, (0.0, 0.5), given.runs, given.out)
    if "equal" in wanted:
        at_equal_time(given.runs, given.out)
    for part, routes in (("maps", ROUTES), ("flat", FLAT)):
        if part in wanted:
            over(routes, given.runs, given.data, given.out)


if __name__ == "__main__":
    main()
