"""Flags of settings that are dictionaries: `--data.units height ft speed kn`, or `--data.units.height ft`."""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, TypeVar

from motes.cli.options import refuse

Settings = TypeVar("Settings")


def dictionaries(settings: Any, prefix: str = "--") -> Iterator[str]:
    """Yield the flags of the fields that are dictionaries."""
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if dataclasses.is_dataclass(value):
            yield from dictionaries(value, f"{prefix}{field.name}.")
        elif isinstance(value, dict):
            yield prefix + field.name


def without_dictionaries(settings: Any, words: Sequence[str]) -> tuple[dict[str, dict[str, str]], list[str]]:
    """Take the flags of dictionaries out of the words: `--data.units height ft speed kn`, and `--data.units.height ft`.

    Returns:
        What they say, by flag, and the other words.

    Raises:
        MotesError: a name has no value.
    """
    known, found, rest = set(dictionaries(settings)), {}, []
    at, words = 0, list(words)
    while at < len(words):
        flag, mark, value = words[at].partition("=")
        whole = next((one for one in known if flag == one or flag.startswith(f"{one}.")), None)
        at += 1
        if whole is None:
            rest.append(words[at - 1])
            continue
        values = [value] if mark else []
        while at < len(words) and not words[at].startswith("--") and not (mark or (flag != whole and values)):
            values.append(words[at])
            at += 1
        pairs = [flag[len(whole) + 1:], *values] if flag != whole else values
        if len(pairs) % 2 or not pairs:
            refuse(flag, "names with a value each, such as height ft", " ".join(values) or "nothing")
        found.setdefault(whole, {}).update(zip(pairs[::2], pairs[1::2], strict=True))
    return found, rest


def with_dictionaries(settings: Settings, found: dict[str, dict[str, str]], prefix: str = "--") -> Settings:
    """Return settings with what flags say of dictionaries added."""
    changes: dict[str, Any] = {}
    for field in dataclasses.fields(settings):  # type: ignore[arg-type]
        value = getattr(settings, field.name)
        if dataclasses.is_dataclass(value):
            changes[field.name] = with_dictionaries(value, found, f"{prefix}{field.name}.")
        elif prefix + field.name in found:
            changes[field.name] = {**value, **found[prefix + field.name]}
    return dataclasses.replace(settings, **changes)  # type: ignore[type-var]
