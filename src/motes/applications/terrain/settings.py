"""What a user can set of a flight, as plain records without arrays: they mirror the tables of a TOML file and cost no import of JAX."""

import math
from dataclasses import dataclass, field

from motes.io.dialect import Dialect


@dataclass(frozen=True)
class Noises:
    """Standard deviations of the noises; those of the process grow with the square root of time.

    Attributes:
        position: random walk of each position error, m/sqrt(s).
        velocity: random walk of each velocity error, m/s/sqrt(s); of nine states only.
        acceleration: random walk of each acceleration error, m/s^2/sqrt(s); of nine states only.
        altimeter: error of one height above terrain, map errors included, m.
    """

    position: float = 2.0
    velocity: float = 0.02
    acceleration: float = 1e-4
    altimeter: float = 15.0


@dataclass(frozen=True)
class Prior:
    """Standard deviations of the inertial errors at the first fix.

    Attributes:
        horizontal_position: m, north and east.
        vertical_position: m.
        horizontal_velocity: m/s, north and east.
        vertical_velocity: m/s.
        horizontal_acceleration: m/s^2, north and east; half a degree of tilt and 0.01 m/s^2 of bias unless said otherwise. Of nine
            states only.
        vertical_acceleration: m/s^2; of nine states only.
        attitude: degrees about each axis; of 15 states only, as what follows.
        accelerometer_bias: m/s^2.
        gyro_bias: degrees per hour. Dahia et al. (2004) print 0.06 degrees per second, here 216: then the gyros alone lead astray by
            three kilometers in its two minutes, so that per hour was probably meant.
    """

    horizontal_position: float = 1000.0
    vertical_position: float = 100.0
    horizontal_velocity: float = 5.0
    vertical_velocity: float = 1.0
    horizontal_acceleration: float = math.hypot(9.81 * math.radians(0.5), 0.01)
    vertical_acceleration: float = 0.01
    attitude: float = 0.5
    accelerometer_bias: float = 0.01
    gyro_bias: float = 0.06


@dataclass(frozen=True)
class Inertial:
    """How the errors of the inertial system are modeled.

    Attributes:
        states: 9 (position, velocity and acceleration errors), or 15 (attitude, velocity and position errors, biases of accelerometers and
            gyros: Dahia, Musso, Pham, Guibert 2004 in full, for straight level flight).
        grade: noise of the sensors, "navigation", "tactical" or "consumer"; of 15 states only.
    """

    states: int = 9
    grade: str = "tactical"


NOISES, PRIOR, INERTIAL = Noises(), Prior(), Inertial()


@dataclass(frozen=True)
class MapFiles:
    """The map.

    Attributes:
        files: DTED, HGT, GeoTIFF or npz files; neighbors on one grid are joined.
        nodata: a height in the files that means "unknown".
        unit: of the heights in the files, such as "ft".
        outside: what to do with a flight that leaves the map: "refuse" it, or take fixes whose inertial position lies outside as "missing"
            (what lies there is then a void).
    """

    files: tuple[str, ...] = field(default=(), metadata={"path": True})
    nodata: float | None = None
    unit: str = "m"
    outside: str = "refuse"


@dataclass(frozen=True)
class Recording(Dialect):
    """The table of measurements, CSV, JSON or Parquet, one row per fix.

    Attributes:
        file: the table.
        coordinates: "local": columns are meters north and east of the map's south-west post; "map": the map's own coordinates
            (latitude and longitude in degrees, or northing and easting in meters).
        inertial: names of three columns of the inertial track: north or latitude, east or longitude, altitude in meters.
        height: name of the column of heights above terrain by the altimeter, meters; empty cells are fixes that failed.
        time: name of the column of times, seconds or dates; "" where fixes are `step` apart.
        step: seconds between fixes where there is no column of times.
        truth: names of the columns of the true north (or latitude) and east (or longitude), for scoring; none if not known.
    """

    file: str = field(default="", metadata={"path": True})
    coordinates: str = "local"
    inertial: tuple[str, ...] = field(default=("ins_north", "ins_east", "ins_altitude"), metadata={"column": True})
    height: str = field(default="height", metadata={"column": True})
    time: str = field(default="time", metadata={"column": True})
    step: float = 0.3
    truth: tuple[str, ...] = field(default=(), metadata={"column": True})


@dataclass(frozen=True)
class Route:
    """A straight level flight, to simulate.

    Attributes:
        north: where it starts, meters north of the map's south-west post.
        east: where it starts, meters east of it.
        heading: degrees from north, clockwise.
        clearance: altitude above the highest point of the map, m.
        speed: m/s.
        step: seconds between fixes.
        fixes: number of fixes.
    """

    north: float = 4000.0
    east: float = 3000.0
    heading: float = 45.0
    clearance: float = 500.0
    speed: float = 250.0
    step: float = 0.3
    fixes: int = 400


FIRST = Route()


@dataclass(frozen=True)
class Settings:
    """Find an aircraft by its radio altimeter over relief; without files a flight over the map that matplotlib ships is made up.

    Attributes:
        map: the map.
        data: the measurements; a flight along the route is made up where no file is named.
        inertial: how the errors of the inertial system are modeled.
        noises: standard deviations of process and altimeter.
        prior: standard deviations at the first fix.
        route: the flight that is made up.
    """

    map: MapFiles = MapFiles()
    data: Recording = Recording()
    inertial: Inertial = INERTIAL
    noises: Noises = NOISES
    prior: Prior = PRIOR
    route: Route = FIRST
