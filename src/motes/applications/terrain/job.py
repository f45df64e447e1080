"""Terrain-aided navigation as an application: `motes demo terrain`, and `motes run`, `motes plan` and `motes study` of its settings."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from motes.applications.interface import Job, Score
from motes.applications.terrain import scenario
from motes.applications.terrain.model import corrected, places_of
from motes.applications.terrain.pictures import Tracks, error_figure, map_figure, relief
from motes.applications.terrain.recording import own_unit, roles, units_of
from motes.applications.terrain.roughness import roughness
from motes.applications.terrain.settings import Recording, Settings
from motes.filters.frames import deviations
from motes.filters.history import History
from motes.filters.marginalized import MarginalizedParticleFilter
from motes.filters.particle import ParticleFilter
from motes.io.archive import whole_file
from motes.io.result_table import Table
from motes.io.units import back_to
from motes.plotting.plot import plot
from motes.report.scene import Marks, Scene

PARTICLES = 15_000
COLUMNS = ("time", "ins_north", "ins_east", "ins_altitude", "height", "true_north", "true_east")
DIGITS = 3
"""After the point, of what is written."""


def load(settings: Settings, seed: int) -> "TerrainJob":
    """Load the flight that the settings name, or make one up.

    Args:
        settings: of the application.
        seed: of a flight that is made up.

    Raises:
        FileError: a file cannot be used.
        MotesError: a setting cannot be used, or the map does not cover the flight.
    """
    errors = (settings.noises, settings.prior, settings.inertial)
    if settings.data.file:
        flight = scenario.loaded(settings.map, settings.data, *errors)
    else:
        terrain = scenario.load_map(settings.map) if settings.map.files else None
        flight = scenario.simulated(seed, terrain, settings.route, *errors, outside=settings.map.outside)
    position = ("rN", "rE")
    return TerrainJob(
        model=flight.model, ys=flight.ys, inputs=flight.inputs, truth=flight.errors, times=flight.seconds, flight=flight,
        start=flight.start, clock=flight.clock, recording=settings.data,
        filters={"marginalized": MarginalizedParticleFilter(n=PARTICLES), "particle": ParticleFilter(n=PARTICLES)},
        counted=position, blocks={"position": position, "velocity": ("vN", "vE")}, lost=("position", scenario.LOST),
    )  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class TerrainJob(Job):
    """A flight; errors are horizontal distances.

    Attributes:
        flight: what was measured, and what is known of the truth.
        recording: how the user's table is written.
    """

    flight: scenario.Flight
    recording: Recording

    def about(self) -> str:
        """Tell whether the terrain is rough enough."""
        return str(roughness(self.flight.model, self.flight.inputs))

    def title(self, steps: int) -> str:
        """Return the length of the flight."""
        return f"{steps} fixes over {self.flight.seconds[-1]:.0f} s; horizontal errors"

    def scores(self, history: History) -> tuple[Score, ...]:
        """Judge a run by the true track; nothing where that is not known."""
        found = scenario.score(history, self.flight)
        if found is None:
            return Score("final error", None, "m"), Score("median error", None, "m")
        return Score("final error", found.final, "m", 1), Score("median error", found.median, "m", 1)

    def verdict(self, history: History) -> str:
        """Say nothing: the table tells all."""
        return ""

    def track(self, history: History) -> Table:
        """Return the places that a run found, in the coordinates and units of the user's table; standard deviations in meters."""
        flight, recording = self.flight, self.recording
        places = [np.asarray(part, np.float64) for part in corrected(flight.inputs, history.mean, history.names)]
        if recording.coordinates == "map":
            places[:2] = flight.terrain.to_geographic(*places[:2])
        spreads = deviations(np.asarray(history.cov, np.float64))[:, np.array(places_of(history.names))]
        expected = units_of(flight.terrain, recording)
        inertial = [(role, name) for role, name in roles(recording).items() if name in recording.inertial]
        own = {name: back_to(place, own_unit(recording, role), expected[name])
               for place, (role, name) in zip(places, inertial, strict=True)}  # fmt: skip
        return self.way(history, own, dict(zip(("north, m", "east, m", "altitude, m"), spreads.T, strict=True)))

    def scene(self) -> Scene:
        """Return the map in kilometers, with the inertial track; the states, which are errors of that, can be chosen, too."""
        flight, names = self.flight, tuple(self.model.names)
        inertial = np.stack([np.asarray(flight.inputs.east), np.asarray(flight.inputs.north)], axis=1) / 1e3
        picture, extent = relief(flight.terrain)

        def place(points: np.ndarray, u: Any, step: int) -> np.ndarray:
            north, east, _ = corrected(u, points.T, names)  # type: ignore[reportArgumentType]
            return np.concatenate([np.stack([east, north]) / 1e3, points])

        truth = np.full((len(inertial), 2 + len(names)), np.nan)
        if flight.truth is not None:
            truth[:, :2] = np.asarray(flight.truth)[:, 1::-1] / 1e3
        if flight.errors is not None:
            truth[:, 2:] = np.asarray(flight.errors)
        return Scene(names=("east", "north", *names), units=("km", "km"), place=place, picture=picture, extent=extent, title="Terrain",
                     truth=None if flight.truth is None else truth, marks=(Marks("inertial track", inertial, "line"),))  # fmt: skip

    def pictures(self, histories: Mapping[str, History]) -> dict[str, Any]:
        """Draw the map with the tracks, the errors, and the states."""
        flight, (first, history) = self.flight, next(iter(histories.items()))
        across = np.array(places_of(history.names)[:2])
        covs = np.asarray(history.cov)[:, across[:, None], across]
        inertial = (np.asarray(flight.inputs.north), np.asarray(flight.inputs.east))
        north, east, _ = corrected(flight.inputs, history.mean, history.names)
        true = None if flight.truth is None else (np.asarray(flight.truth[:, 0]), np.asarray(flight.truth[:, 1]))
        tracks = Tracks(inertial, (np.asarray(north), np.asarray(east)), covs, true)
        found = {"map.png": map_figure(flight.terrain, tracks, f"{first} filter"), "states.png": plot(history, truth=flight.errors)}
        if true is not None:
            places = {name: corrected(flight.inputs, one.mean, one.names) for name, one in histories.items()}
            errors = {name: scenario.horizontal_errors(place, flight) for name, place in places.items()}
            errors["inertial only"] = scenario.horizontal_errors(inertial, flight)
            found["error.png"] = error_figure(flight.seconds, errors, np.sqrt(covs[:, 0, 0] + covs[:, 1, 1]), scenario.LOST)
        return found

    def written(self, folder: Path, settings: Settings) -> Settings:
        """Write a flight that was made up: its table, and the map where that is matplotlib's."""
        if settings.data.file:
            return settings
        files = settings.map.files
        if not files:
            source = scenario.jacksboro_file()
            files = (str(folder / source.name),)
            with whole_file(folder / source.name) as file:
                file.write(source.read_bytes())
        self._table().save(folder / "flight.csv")
        data = replace(settings.data, file=str(folder / "flight.csv"), truth=COLUMNS[-2:])
        return replace(settings, map=replace(settings.map, files=files), data=data)

    def _table(self) -> Table:
        flight = self.flight
        assert flight.truth is not None
        inertial, truth = flight.inputs, flight.truth
        columns = (flight.seconds, inertial.north, inertial.east, inertial.altitude, flight.ys[:, 0], truth[:, 0], truth[:, 1])
        rows = np.stack([np.asarray(column, np.float64) for column in columns], axis=1).round(DIGITS)
        return Table(COLUMNS, tuple(map(tuple, rows.tolist())))
