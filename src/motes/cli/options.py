"""Options from TOML files and flags, both mirrored by frozen dataclasses: a table is a nested dataclass, a key is a field."""

import contextlib
import dataclasses
import io
import os
import re
import reprlib
import tomllib
import types
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from motes.core.spelling import perhaps

Settings = TypeVar("Settings")
LARGEST = 1 << 20
DOTS = 3000
LARGEST_WHOLE = 10**300
UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
OF_COLUMN = {"column": "", "unit": "units", "format": "time_format", "zone": "time_zone"}
"""Keys of a table that tells of a column, and those of the table of data that say the same."""
KINDS = {int: "a whole number", float: "a number", str: "text in quotes", bool: "true or false", tuple: "a list of texts",
         dict: "a table of texts"}  # fmt: skip


def refuse(argument: str, expected: str, given: object, hint: str = "") -> NoReturn:
    """Refuse in the library's words; imported late, since it brings JAX."""
    from motes.core import checks

    checks.refuse(argument, expected, given, hint)


def from_flags(default: Settings, words: Sequence[str], command: str) -> Settings:
    """Return settings with the flags that the user gave; `--help` prints them and leaves with code 0.

    Args:
        default: the settings where no flag is given.
        words: the flags.
        command: words that lead here, such as "motes run".

    Raises:
        MotesError: a flag is unknown or its value cannot be used.
    """
    import tyro

    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            args = _together(default, words)
            found = tyro.cli(type(default), args=args, default=default, prog=command, config=(tyro.conf.AvoidSubcommands,))
    except SystemExit as leaving:
        if not leaving.code:
            raise
        text, meant = _first_words(said.getvalue()), re.search(r"Perhaps you meant:[\s\u2502]*(--[\w.-]+)", said.getvalue())
        refuse("options", f"those that {command} --help lists", text, f"Perhaps {meant[1]} is meant." if meant else "")
    return _at_home(found)


def _together(default: Any, words: Sequence[str]) -> list[str]:
    """Return the words with the values of a flag that takes several and came several times at its first place."""
    several = {f"--{field.name.replace('_', '-')}" for field in dataclasses.fields(default) if type(getattr(default, field.name)) is tuple}
    parts: list[list[str]] = [[]]
    for word in words:
        flag, _, value = word.partition("=")
        if flag not in several:
            parts[-1].append(word) if not word.startswith("--") else parts.append([word])
            continue
        before = next((part for part in parts if part[:1] == [flag]), None)
        parts.append(before if before is not None else [flag])
        parts[-1] += [value] if "=" in word else []
    return [word for place, part in enumerate(parts) if all(part is not one for one in parts[:place]) for word in part]


def check_seed(seed: int) -> None:
    """Refuse a seed that the random stream cannot take."""
    if not 0 <= seed < 2**32:
        refuse("seed", "a whole number from 0 to 4294967295", seed)


def _first_words(box: str) -> str:
    """Return what a framed message says before its first rule, on one line."""
    found = []
    for line in box.splitlines()[1:]:
        text = line.strip("│ ")
        if not text.strip("─╰╯"):
            break
        found.append(text)
    return " ".join(found).rstrip(".")


def from_table(kind: type[Settings], table: Any, path: str, place: str = "") -> Settings:
    """Return settings from the table of a TOML file, or from the table at some place of it; paths in it are relative to its folder.

    Args:
        kind: a frozen dataclass whose fields all have defaults.
        table: what the file has.
        path: the file.
        place: of the table.

    Raises:
        MotesError: a key is unknown or a value has another kind; the message names it.
    """
    if not isinstance(table, dict):
        refuse(f"{Path(path).name}: {place}", f"a table [{place}]", shown(table))
    return _from_table(kind, table, Path(path), place)


def read_toml(path: str) -> dict[str, Any]:
    """Read the table of a TOML file.

    Raises:
        FileError: the file is missing, larger than 1 MB or not UTF-8, or is no TOML; the message names the line.
    """
    from motes.io.files import foreign, look, reject

    size, _ = look(path, 1)
    if size > LARGEST:
        reject(path, f"a TOML file of at most {LARGEST} bytes", f"{size} bytes")
    with foreign(path, "a TOML file"):
        text = Path(path).read_text(encoding="utf-8-sig")
        # the parser takes time and memory with the square of the parts of a key
        if text.count(".") > DOTS:
            reject(path, f"a TOML file with at most {DOTS} points", text.count("."))
        return tomllib.loads(text)


def first_and_flags(default: Any, words: Sequence[str], usage: str, expected: str, hint: str) -> tuple[str, Sequence[str]]:
    """Return the word that comes first and the flags after it; `--` says that what follows is no flag, however it begins.

    Args:
        default: the settings where no flag is given.
        words: of the command line, after the command.
        usage: the command, for messages and help.
        expected: what comes first, for the message where it is missing.
        hint: how to get it.

    Raises:
        MotesError: no such word is there, or what `from_flags` raises.
    """
    if list(words[:1]) == ["--"] and len(words) > 1:
        return words[1], words[2:]
    if words and words[0].startswith("-"):
        from_flags(default, words, usage)
    if not words or words[0].startswith("-"):
        refuse("arguments", expected, shown(" ".join(words)) if words else "nothing", hint)
    return words[0], words[1:]


def _from_table(kind: Any, table: dict[str, Any], path: Path, place: str) -> Any:
    fields = {field.name: field for field in dataclasses.fields(kind)}
    hints = typing.get_type_hints(kind)
    where = f"{path.name}: [{place}]" if place else path.name
    given = {}
    for key, value in _with_names(kind, table, where).items():
        if key not in fields:
            refuse(where, f"the keys {', '.join(fields)}", shown(key), perhaps(key, fields))
        if dataclasses.is_dataclass(hints[key]):
            if isinstance(value, str) and "file" in hints[key].__dataclass_fields__:
                # the name of a file alone stands for its table
                value = {"file": value}
            if not isinstance(value, dict):
                refuse(f"{where} {key}", f"a table [{key}]", shown(value))
            given[key] = _from_table(hints[key], value, path, f"{place}.{key}" if place else key)
            continue
        if fields[key].metadata.get("cells"):
            value = _cells(value)
        given[key] = _value(hints[key], value, f"{where} {key}")
        if fields[key].metadata.get("path"):
            given[key] = _beside(path.parent, given[key])
    return kind(**given)


def _with_names(kind: Any, table: dict[str, Any], where: str) -> dict[str, Any]:
    """Return a table in which columns are names; what tables of columns say besides is under `units`, `time_format` and `time_zone`.

    Raises:
        MotesError: a table of a column has another key, or no text where one is due.
    """
    found, said = dict(table), []
    for field in dataclasses.fields(kind):
        value = table.get(field.name)
        if not field.metadata.get("column") or not isinstance(value, (list, dict)):
            continue
        place = f"{where} {field.name}"
        if isinstance(value, list):
            found[field.name] = [_column(one, place, "", said) for one in value]
        elif typing.get_origin(field.type) is dict:
            found[field.name] = {role: _column(one, f"{place} {role}", role, said) for role, one in value.items()}
        else:
            default = field.default if isinstance(field.default, str) else ""
            found[field.name] = _column(value, place, default, said)
    for key, one in said:
        if isinstance(one, dict):
            found[key] = {**found[key], **one} if isinstance(found.get(key), dict) else one
        elif found.setdefault(key, one) != one:
            refuse(f"{where} {key}", "one for all times", f"{shown(found[key])} and {shown(one)}")
    return found


def _column(value: Any, place: str, default: str, said: list[tuple[str, Any]]) -> Any:
    """Return the name of a column that is told by a table; what that says besides is added to what was said."""
    if not isinstance(value, dict):
        return value
    for key, text in value.items():
        if key not in OF_COLUMN:
            refuse(place, f"the keys {', '.join(OF_COLUMN)}", shown(key), perhaps(key, OF_COLUMN))
        if not isinstance(text, str):
            refuse(f"{place} {key}", "a text in quotes", shown(text))
    name = value.get("column", default)
    if not name:
        refuse(place, 'column = "its name"', "none")
    said += [("units", {name: text}) if key == "unit" else (OF_COLUMN[key], text) for key, text in value.items() if key != "column"]
    return name


def _value(hint: Any, value: Any, where: str) -> Any:
    """Return a value of a TOML file in the kind of its field."""
    if isinstance(hint, types.UnionType):
        hint = next(option for option in typing.get_args(hint) if option is not types.NoneType)
    if typing.get_origin(hint) is typing.Literal:
        known = typing.get_args(hint)
        if value not in known or type(value) is bool:
            refuse(where, "one of " + ", ".join(map(repr, known)), shown(value), perhaps(value, map(str, known)))
        return value
    if typing.get_origin(hint) is dict:
        if isinstance(value, dict) and all(isinstance(item, str) for item in value.values()):
            return value
        refuse(where, KINDS[dict], shown(value))
    if typing.get_origin(hint) is tuple:
        value = [value] if isinstance(value, str) else value
        if isinstance(value, list) and all(isinstance(item, str) for item in value):
            return tuple(value)
        refuse(where, KINDS[tuple], shown(value))
    if hint is float and type(value) is int and abs(value) < LARGEST_WHOLE:
        return float(value)
    if type(value) is not hint:
        refuse(where, KINDS[hint], shown(value))
    return value


def _cells(value: Any) -> Any:
    """Return what stands in cells of a table as texts: numbers may be written as such."""
    several = value if isinstance(value, list) else [value]
    return [repr(one) if type(one) in (int, float) else one for one in several]


def shown(value: Any) -> str:
    """Return a value as a message repeats it: its beginning and end, however long or deep it is."""
    brief = reprlib.Repr()
    brief.maxlevel, brief.maxstring, brief.maxother = 2, 80, 80
    return brief.repr(value)


def _beside(folder: Path, value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(_beside(folder, item) for item in value)
    # a path from the home folder stands on its own (see `_at_home`), as do addresses and the standard streams
    return value if not value or value.startswith("~") or value == "-" or "://" in value else os.path.join(folder, value)


def _at_home(settings: Settings) -> Settings:
    """Return settings with `~` in their paths as the home folder, as a shell would have it."""
    changes = {}
    for field in dataclasses.fields(settings):  # type: ignore[arg-type]
        value = getattr(settings, field.name)
        if dataclasses.is_dataclass(value):
            changes[field.name] = _at_home(value)
        elif field.metadata.get("path"):
            changes[field.name] = tuple(map(_expanded, value)) if isinstance(value, tuple) else _expanded(value)
    return dataclasses.replace(settings, **changes)  # type: ignore[type-var]


def _expanded(path: str) -> str:
    found = os.path.expanduser(path)
    if found.startswith("~"):
        refuse("path", "a home folder that there is", shown(path), "Write ./ in front where a name begins with ~.")
    return found


def seconds(text: str) -> float:
    """Return seconds from a number with a unit.

    Raises:
        MotesError: it is none.
    """
    found = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*(s|ms|us)\s*", text)
    if not found or not float(found[1]) > 0:
        refuse("budget", "a time with its unit, such as 5ms, 200us or 0.1s", repr(text))
    return float(found[1]) * UNITS[found[2]]
