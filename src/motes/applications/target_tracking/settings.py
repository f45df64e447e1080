"""What a user can set of the tracker, and the numbers of its radar, as records without arrays."""

from dataclasses import dataclass, field

from motes.applications.aircraft.settings import Site
from motes.io.dialect import TableFile

DEMO = "notch"
"""What `motes demo` shows of it: an aircraft in the radar's blind zone."""


@dataclass(frozen=True)
class Radar:
    """The radar, which stands at the origin.

    Attributes:
        distance: standard deviation of the range, m.
        azimuth: of the azimuth, radians.
        rate: of the range rate, m/s.
        detection: probability of detection of what is not in the notch.
        notch: range rate below which it falls to nothing, m/s; 0 for a radar that is blind to nothing but what stands.
        edge: over how many m/s it falls.
        false: expected number of false plots in a scan, evenly over range, azimuth and range rate.
        farthest: range to which plots lie, m.
        fastest: range rate to which they do, m/s.
    """

    distance: float = 50.0
    azimuth: float = 3e-3
    rate: float = 2.0
    detection: float = 0.9
    notch: float = 25.0
    edge: float = 2.0
    false: float = 10.0
    farthest: float = 60e3
    fastest: float = 400.0


@dataclass(frozen=True)
class Settings:
    """Follow aircraft by radar, also where the radar is blind to them, among false plots.

    Attributes:
        data: plots with the columns time (s, or dates), range (m), azimuth (degrees from north) and range_rate (m/s), in order of time;
            those of one time are one scan, a row with a time alone a scan that saw nothing. Or a recording of ADS-B reports, also of
            several aircraft (column icao24), with the columns that the application aircraft reads: plots are drawn along its flights.
            Flights are made up where no file is named.
        truth: true states for scoring, a file, written as the plots are, with the columns time, east, north (m), v_east and v_north (m/s),
            and target (a name or a number) where there are several; none if empty.
        targets: number of flights that are made up. Where it is not 1 (0 for a file), or the truth or the recording has several, their
            number counts as unknown: tracks begin and end by themselves.
        period: seconds between scans; scans of the file that lie further apart are filled up with some that saw nothing, unless it is 0.
        scans: of flights that are made up, or along a recording.
        begin: of the part of a recording that is used, seconds since its first report.
        site: the radar, from the middle of that part.
        radar: its accuracy, and what it does not see.
    """

    data: TableFile = TableFile()
    truth: str = field(default="", metadata={"path": True})
    targets: int = 1
    period: float = 2.0
    scans: int = 70
    begin: float = 0.0
    site: Site = Site()
    radar: Radar = Radar()
