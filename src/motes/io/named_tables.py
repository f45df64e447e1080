"""Tables whose columns have fixed names, unless the user says what they are called."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace

from motes.core.checks import FileError, refuse
from motes.io.columns import Columns, MissingColumnError
from motes.io.dialect import NamedDialect
from motes.io.guesses import Guess, guessed, named, proposing
from motes.io.tables import column_names, read_table


def read_named(
    path: str | os.PathLike[str],
    roles: Mapping[str, str],
    data: NamedDialect,
    texts: Sequence[str] = (),
    beside: Sequence[str] = (),
) -> Columns:
    """Read the columns of a table under their fixed names.

    Args:
        path: the file.
        roles: what is asked for, and the unit of each, "s" for times; "" for numbers without one.
        data: how the table is written, and what its columns are called.
        texts: columns of text, read where they are there.
        beside: other names that the user may say columns of: of tables beside this one.

    Raises:
        FileError: the file cannot be used; where columns are missing, the message proposes which may be meant.
        MotesError: what is said of columns or units cannot be used.
    """
    there = (*roles, *texts, *beside)
    for key in data.columns:
        if key not in there:
            refuse("columns", f"what is asked for: {', '.join(there)}", repr(key[:60]), "It stands left of its name in the file.")
    names = {role: data.columns.get(role, role) for role in (*roles, *texts)}
    own = {names.get(key, key): unit for key, unit in data.units.items()}
    # units of columns of the tables beside this one are none of its own; of a name that is nobody's it is told
    others = {name for role in beside for name in (role, data.columns.get(role, role))} - {*names.values()}
    dialect = replace(data, units={name: unit for name, unit in own.items() if name not in others})
    expected = {names[role]: unit for role, unit in roles.items() if unit}
    try:
        table = read_table(path, [names[role] for role in roles], [names[text] for text in texts], dialect, expected)
    except MissingColumnError as reason:
        raise _with_proposal(reason, roles, names) from None
    return table.called(names)


def named_columns(path: str | os.PathLike[str], data: NamedDialect) -> list[str]:
    """Return the names of the columns of a file as they are asked for.

    Raises:
        FileError: the file cannot be read.
    """
    fixed = {name: role for role, name in data.columns.items()}
    return [fixed.get(name, name) for name in column_names(path, data)]


def own_unit(data: NamedDialect, role: str) -> str:
    """Return the unit that the user told of a column, by what it is or by its name; "" for none."""
    return data.units.get(role, data.units.get(data.columns.get(role, role), ""))


def _with_proposal(reason: MissingColumnError, roles: Mapping[str, str], names: Mapping[str, str]) -> FileError:
    """Return a refusal with lines of TOML that name the columns that may be meant."""
    told = {role: name for role, name in names.items() if name in reason.names}
    found = guessed([role for role in roles if role not in told], [name for name in reason.names if name not in told.values()])
    lost = [role for role in roles if role not in told and role not in found]
    kept = {role: Guess(name, "") for role, name in told.items() if role != name}
    line = named(kept | {role: found[role] for role in roles if role in found}, roles)
    return proposing(reason, [line] if found else [], lost)
