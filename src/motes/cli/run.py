"""`motes run CONFIG.toml`: run a filter on the user's own map and measurements; on the user's own model see `run_own.py`.

The TOML file has the tables [map], [data], [inertial], [noises], [prior] and [filter] and the keys `seed` and `out`; all but `files` of
[map] and `file` of [data] have defaults. `motes demo` writes one, with comments, beside a flight that it fits. Paths in the file are
relative to its folder, those in flags to where the command is called. Writes the same files as `motes demo`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from motes.applications.terrain_navigation.settings import Inertial, MapFiles, Noises, Prior, Recording
from motes.cli.compiled import keep_programs
from motes.cli.filters import FilterChoice, build
from motes.cli.options import check_seed, from_file_and_flags
from motes.cli.own import is_own

USAGE = "motes run CONFIG.toml"


@dataclass(frozen=True)
class Config:
    """Run a filter on your own map and measurements; CONFIG.toml comes first, flags change single keys of it.

    Attributes:
        map: the map.
        data: the measurements.
        inertial: how the errors of the inertial system are modeled.
        noises: standard deviations of process and altimeter.
        prior: standard deviations at the first fix.
        filter: the filter.
        seed: of the filter.
        out: folder for the results.
    """

    map: MapFiles = MapFiles()
    data: Recording = Recording()
    inertial: Inertial = Inertial()
    noises: Noises = Noises()
    prior: Prior = Prior()
    filter: FilterChoice = FilterChoice()
    seed: int = 0
    out: str = field(default="out", metadata={"path": True})


def main(words: Sequence[str]) -> None:
    """Run what the file asks for.

    Raises:
        MotesError: the file, what it names, or an option cannot be used.
    """
    if is_own(words):
        from motes.cli import run_own

        return run_own.main(words)
    config = from_file_and_flags(Config, words, USAGE)
    check_seed(config.seed)
    keep_programs()
    from motes.applications.terrain_navigation import scenario
    from motes.cli.terrain import fly

    filters = {config.filter.kind: build(config.filter)}
    flight = scenario.load(config.map, config.data, config.noises, config.prior, config.inertial)
    folder = fly(flight, filters, config.seed, config, config.out)
    print(f"Results are in {folder}.")
