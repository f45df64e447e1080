"""`motes demo terrain`: find an aircraft by its radio altimeter over the map that matplotlib ships.

Writes to the folder `--out`: one NetCDF history per filter, `summary.json`, `map.png`, `error.png`, `states.png`; and, to be changed and
flown again with `motes run`, the flight itself: `flight.csv`, the map, `terrain.toml`.
"""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from motes.applications.terrain_navigation.settings import ROUTES, Inertial, Noises
from motes.cli.compiled import keep_programs
from motes.cli.filters import FilterChoice, build
from motes.cli.options import check_seed, from_flags, refuse

if TYPE_CHECKING:
    from motes.applications.terrain_navigation.scenario import Flight

SHOWN = ("marginalized", "particle")
COLUMNS = ("time", "ins_north", "ins_east", "ins_altitude", "height", "true_north", "true_east")


@dataclass(frozen=True)
class Demo:
    """Find an aircraft by its radio altimeter over real relief.

    Attributes:
        n: number of particles of each filter.
        seed: of the flight and of the filters.
        out: folder for the results.
        filter: filters to compare: marginalized, particle, kernel, regularized; the pictures show the first.
        route: which of two flights.
        position_noise: random walk of the inertial position error, m/sqrt(s).
        states: of the inertial errors, 9 or 15.
        study: number of flights on which to compare the filters of Dahia et al. (2004), each with its own particles; 0 for one flight.
    """

    n: int = FilterChoice.n
    seed: int = 0
    out: str = field(default="out", metadata={"path": True})
    filter: tuple[str, ...] = SHOWN
    route: Literal["first", "second"] = "first"
    position_noise: float = Noises.position
    states: Literal[9, 15] = 9
    study: int = 0


def main(words: Sequence[str]) -> None:
    """Fly the demonstration.

    Raises:
        MotesError: an option cannot be used, or a file cannot be written.
    """
    settings = from_flags(Demo(), words, "motes demo terrain")
    check_seed(settings.seed)
    keep_programs()
    from motes.applications.terrain_navigation import scenario
    from motes.cli.terrain import fly

    if settings.study:
        return study(settings)
    filters = {kind: build(FilterChoice(kind=kind, n=settings.n)) for kind in settings.filter or SHOWN}
    flight = scenario.simulated(settings.seed, route=ROUTES[settings.route], noises=Noises(position=settings.position_noise),
                                kind=Inertial(states=settings.states))
    folder = fly(flight, filters, settings.seed, settings, settings.out)
    write_flight(flight, settings, folder)
    print(f"Results are in {folder}. The same flight from its files: motes run {folder / 'terrain.toml'}")


def study(settings: Demo) -> None:
    """Compare the filters of Dahia, Musso, Pham, Guibert (2004) on many flights; writes `study.csv` and `study.png`."""
    from motes.applications.terrain_navigation import comparison, scenario
    from motes.cli import running
    from motes.plotting.terrain import comparison_figure

    if settings.study < 0:
        refuse("study", "a number of flights of at least 0", settings.study)
    running.check_folder(settings.out)

    def flight(seed: int, position: float) -> "Flight":
        kind = Inertial(states=settings.states)
        return scenario.simulated(seed, route=ROUTES[settings.route], noises=Noises(position=position), kind=kind)

    flights = [flight(settings.seed + k, settings.position_noise) for k in range(settings.study)]
    wide = flight(settings.seed, max(2.0, 2 * settings.position_noise)).model
    found = comparison.compare(flights, comparison.usual_rivals(flights[0].model, wide), settings.seed)
    print(found.table)
    folder = running.made_folder(settings.out)
    found.table.save(folder / "study.csv")
    running.write_figure(folder / "study.png", comparison_figure(flights[0].seconds, found.curves))
    print(f"Results are in {folder}.")


def write_flight(flight: "Flight", settings: Demo, folder: Path) -> None:
    """Write the flight as a user's own would come: a table, a map, and the TOML file that names them."""
    from motes.applications.terrain_navigation.scenario import jacksboro_file
    from motes.cli.running import write_text
    from motes.io.archive import whole_file

    map_file = jacksboro_file()
    with whole_file(folder / map_file.name) as file:
        file.write(map_file.read_bytes())
    table = io.StringIO()
    rows = csv.writer(table, lineterminator="\n")
    rows.writerow(COLUMNS)
    inertial, truth = flight.inputs, flight.truth
    assert truth is not None
    columns = (inertial.north, inertial.east, inertial.altitude, flight.ys[:, 0], truth[:, 0], truth[:, 1])
    for second, *values in zip(flight.seconds, *columns, strict=True):
        rows.writerow([f"{second:.3f}", *(f"{float(value):.3f}" for value in values)])
    write_text(folder / "flight.csv", table.getvalue())
    write_text(folder / "terrain.toml", _TOML.format(
        map=map_file.name, seed=settings.seed, kind=(settings.filter or SHOWN)[0], n=settings.n,
        position=settings.position_noise, states=settings.states))


_TOML = """\
# Run with: motes run terrain.toml     Any key can be changed by a flag, too, such as --filter.n 2000 (see motes run --help).
# Paths are relative to this file.
seed = {seed}
out = "run"

[map]
files = ["{map}"]             # DTED, HGT, GeoTIFF or npz; several neighbors are joined
outside = "refuse"            # a flight that leaves the map; "missing": fixes off the map are missing data

[data]
file = "flight.csv"                                      # CSV or Parquet, one row per fix
coordinates = "local"                                    # meters from the map's south-west post; "map": latitude and longitude
time = "time"                                            # seconds or ISO 8601
inertial = ["ins_north", "ins_east", "ins_altitude"]     # the track of the inertial navigation system
height = "height"                                        # of the radio altimeter above terrain, m; empty where it failed
truth = ["true_north", "true_east"]                      # for scoring; leave it out where it is not known
# missing = -9999                                        # a number that means "not measured", beside empty cells

[inertial]
states = {states}              # errors: 9, or 15 (attitude and sensor biases in place of accelerations; straight level flight)
grade = "tactical"      # of the 15 states: navigation, tactical or consumer

[noises]
position = {position}          # random walks of the inertial errors: m/sqrt(s)
velocity = 0.02         # m/s/sqrt(s)
acceleration = 0.0001   # m/s^2/sqrt(s)
altimeter = 15.0        # m

[prior]                 # standard deviations of the inertial errors at the first fix
horizontal_position = 1000.0
vertical_position = 100.0
horizontal_velocity = 5.0
vertical_velocity = 1.0
attitude = 0.5          # degrees; this and the biases: of the 15 states
accelerometer_bias = 0.01   # m/s^2
gyro_bias = 0.06        # degrees per hour

[filter]
kind = "{kind}"   # marginalized, particle, kernel or regularized
n = {n}
policy = "ess"          # when to resample: ess, entropy, always, never; without this line the filter's own rule
"""
