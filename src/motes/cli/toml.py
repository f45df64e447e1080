"""TOML files written from settings: each key with its help, so that the file explains itself."""

import dataclasses
import inspect
import json
import os
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from motes.io.units import quoted

WIDTH = 120


def written(settings: Any, folder: Path) -> str:
    """Return a TOML text of settings; paths below a folder are written relative to it, all others in full.

    Args:
        settings: a frozen dataclass; a field that is one is a table.
        folder: that the file will lie in.
    """
    return "\n".join(_lines(settings, folder.resolve(), "")) + "\n"


def table(place: str, values: dict[str, Any]) -> str:
    """Return a TOML table of plain values; dictionaries in it are written in line."""
    return "\n".join([f"[{place}]", *(f"{key} = {_plain(value)}" for key, value in values.items())]) + "\n"


def _lines(settings: Any, folder: Path, place: str) -> Iterator[str]:
    told = helps(type(settings))
    # its own fields come before those that it shares with others
    fields = sorted(dataclasses.fields(settings), key=lambda field: field.name not in vars(type(settings)).get("__annotations__", {}))
    tables = [field for field in fields if dataclasses.is_dataclass(getattr(settings, field.name))]
    for field in fields:
        if field in tables:
            continue
        value = getattr(settings, field.name)
        if field.metadata.get("path") and value:
            value = tuple(_near(path, folder) for path in value) if isinstance(value, tuple) else _near(value, folder)
        yield from _comment(told.get(field.name, ""))
        yield f"# {field.name} =" if value is None else f"{field.name} = {_plain(value)}"
    for field in tables:
        inner = f"{place}.{field.name}" if place else field.name
        yield ""
        yield from _comment(told.get(field.name, ""))
        yield f"[{inner}]"
        yield from _lines(getattr(settings, field.name), folder, inner)


def _comment(text: str) -> Iterator[str]:
    return (f"# {line}" for line in textwrap.wrap(text, WIDTH))


def _near(path: str, folder: Path) -> str:
    whole = Path(path).absolute()
    return os.path.relpath(whole, folder) if whole.is_relative_to(folder) else str(whole)


def _plain(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{quoted(key)} = {_plain(one)}" for key, one in value.items()) + " }" if value else "{}"
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(map(_plain, value)) + "]"
    return json.dumps(value)


def helps(kind: type) -> dict[str, str]:
    """Return what the docstrings of a dataclass and of those that it derives from say of each field."""
    found: dict[str, str] = {}
    for one in reversed(kind.__mro__):
        lines = inspect.cleandoc(one.__doc__ or "").partition("Attributes:\n")[2].splitlines()
        for line in lines:
            named = re.match(r" {4}(\w+): (.*)", line)
            if named:
                name = named[1]
                found[name] = named[2]
            elif line.startswith(" " * 8):
                found[name] += " " + line.strip()
    return found
