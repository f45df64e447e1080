"""The data sets: a CSV file each, beside this file, and what there is to say of it."""

import dataclasses
from importlib import resources

import numpy as np

FACTS = "numbers as published, which are facts without protectable expression: free for any use"


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class DataSet:
    """Recorded data as arrays of NumPy.

    Attributes:
        title: what was recorded.
        times: of the rows, `(t,)`: years as whole numbers, days as `datetime64[D]`, or numbers from 0 on where there is no time.
        values: `(t, y)`, as filters take measurements.
        names: of the columns of `values`.
        units: of the columns of `values`.
        source: who recorded or published it.
        licence: what may be done with it.
    """

    title: str
    times: np.ndarray
    values: np.ndarray
    names: tuple[str, ...]
    units: tuple[str, ...]
    source: str
    licence: str

    def __repr__(self) -> str:
        """Say in a few lines what it is; the numbers stay in `values`."""
        columns = ", ".join(f"{name} ({unit})" for name, unit in zip(self.names, self.units, strict=True))
        head = f"{self.title}\n{len(self.times)} rows, {self.times[0]} to {self.times[-1]}: {columns}"
        return f"{head}\nSource: {self.source}\nLicence: {self.licence}"


def nile() -> DataSet:
    """Flow of the Nile at Aswan, yearly, 1871 to 1970, `(100, 1)` in 1e8 m^3; the level broke about 1899."""
    source = "Cobb 1978, The problem of the Nile: conditional solution to a changepoint problem"
    return _shipped("nile", "Flow of the Nile at Aswan, yearly", "1e8 m^3", source)


def coal() -> DataSet:
    """Explosions in British coal mines with ten or more deaths, `(112, 1)` a year, 1851 to 1962: counts whose rate changes."""
    source = "Jarrett 1979, A note on the intervals between coal-mining disasters"
    return _shipped("coal", "Explosions in British coal mines with ten or more deaths, by year", "1/year", source)


def lynx() -> DataSet:
    """Lynx trapped in the Mackenzie River district of Canada, `(114, 1)` a year, 1821 to 1934: counts that swing within ten years."""
    source = "Elton, Nicholson 1942, The ten-year cycle in numbers of the lynx in Canada"
    return _shipped("lynx", "Lynx trapped in the Mackenzie River district, by year", "1/year", source)


def galaxies() -> DataSet:
    """Velocities of 82 galaxies of the Corona Borealis region, `(82, 1)` in km/s and in rising order, the 78th put right (26 960)."""
    source = "Roeder 1990, Density estimation with confidence sets exemplified by superclusters and voids in the galaxies"
    return _shipped("galaxies", "Velocities of galaxies of the Corona Borealis region", "km/s", source)


def pound() -> DataSet:
    """Price of the British pound, `(946, 1)` in US dollars, on working days, 1981-10-01 to 1985-06-28."""
    source = "Harvey, Ruiz, Shephard 1994, Multivariate stochastic variance models"
    return _shipped("pound", "Price of the British pound, on working days", "US dollars", source)


def _shipped(name: str, title: str, unit: str, source: str) -> DataSet:
    head, *lines = resources.files("motes.data").joinpath(f"{name}.csv").read_text(encoding="utf-8").split()
    kind, *names = head.split(",")
    cells = np.array([line.split(",") for line in lines])
    times = cells[:, 0].astype("datetime64[D]" if kind == "date" else np.int64)
    return DataSet(title, times, cells[:, 1:].astype(float), tuple(names), (unit,), source, FACTS)
