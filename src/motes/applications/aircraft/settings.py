"""What a user can set of the aircraft's job, and the numbers of its model, as records without arrays."""

from dataclasses import dataclass

from motes.io.dialect import TableFile


@dataclass(frozen=True)
class Site:
    """Where the radar stands, from the middle of the flight.

    Attributes:
        east: meters.
        north: meters.
    """

    east: float = -25e3
    north: float = -20e3


@dataclass(frozen=True)
class Plots:
    """The plots that are drawn along the flight, at intervals of 1 to 5 s.

    Attributes:
        distance: standard deviation of the range, m.
        azimuth: of the azimuth, radians.
        detection: probability that the aircraft gives one.
        false: expected number of false plots with each, evenly over azimuth and range; with any the tracker is not told which is whose.
        farthest: range to which they lie, m.
        steps: most plots.
    """

    distance: float = 30.0
    azimuth: float = 1e-3
    detection: float = 0.95
    false: float = 0.0
    farthest: float = 150e3
    steps: int = 1_600


@dataclass(frozen=True)
class Settings:
    """Follow an airliner by radar through its turns.

    Attributes:
        data: a recording of ADS-B reports with the columns timestamp (s, or dates), latitude, longitude (degrees), groundspeed (knots) and
            track (degrees from north); a flight is made up where no file is named.
        aircraft: icao24 of the one that is followed, where the recording has several.
        begin: of the part that is flown, seconds since the first report.
        duration: of that part, or of a flight that is made up, seconds.
        site: the radar.
        plots: what it measures.
    """

    data: TableFile = TableFile()
    aircraft: str = ""
    begin: float = 0.0
    duration: float = 4800.0
    site: Site = Site()
    plots: Plots = Plots()
