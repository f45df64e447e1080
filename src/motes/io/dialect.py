"""How people write tables, as a plain record without JAX: settings that read tables derive from it."""

from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class Dialect:
    """How a table is written, where it does not tell that by itself.

    Attributes:
        separator: between the columns of a CSV file: a character, "tab" or "spaces"; told by the line of names if empty.
        decimal: mark of decimals, "." or ",".
        comment: what lines of comments begin with.
        missing: what stands for nothing beside empty cells and N/A, as in [-9999, "lost"].
        units: of columns that are in others than is said here, as in height = "ft"; m, km, ft, nmi, mi, m/s, km/h, kn, mph, ft/min, deg,
            rad, s, ms, ... are known.
        time_format: of times that are no numbers: "iso", "day first", "month first", or as in "%d.%m.%Y %H:%M".
        time_zone: of times that tell none, such as "Europe/Berlin"; UTC if empty.
    """

    separator: str = ""
    decimal: str = "."
    comment: str = "#"
    missing: tuple[str, ...] = field(default=(), metadata={"cells": True})
    units: dict[str, str] = field(default_factory=dict)
    time_format: str = "iso"
    time_zone: str = ""


@dataclass(frozen=True, kw_only=True)
class NamedDialect(Dialect):
    """The dialect of a table whose columns have fixed names, unless they are called otherwise.

    Attributes:
        columns: what columns are called that have other names than are said here, as in time = "Zeit".
    """

    columns: dict[str, str] = field(default_factory=dict, metadata={"column": True})


@dataclass(frozen=True, kw_only=True)
class TableFile(NamedDialect):
    """A table of the user's.

    Attributes:
        file: the table, CSV, JSON or Parquet, also zipped by gzip.
    """

    file: str = field(default="", metadata={"path": True})


PLAIN, NAMED = Dialect(), NamedDialect()
