"""Filters, smoothers and what they are made of, chosen by name with all their parameters: from the records themselves.

A choice is a name, or a table whose `kind` is the name and whose other keys are parameters: `filter = "kalman"`, or
`[filter] kind = "particle", n = 2000, policy = { kind = "ESS", share = 0.3 }`. A flag names the place of a parameter:
`--filter.policy.share 0.3`.
"""

import dataclasses
import difflib
import importlib
import inspect
import re
import tomllib
import types
import typing
from collections.abc import Mapping, Sequence
from typing import Any

from motes.cli.options import KINDS, refuse, shown
from motes.core.spelling import perhaps

KIND = "kind"
ROOMS = ("motes", "motes.filters", "motes.resampling", "motes.smoothers", "motes.gaussian")
"""Where the records are that a user can name."""
MOST = 50_000_000
"""More particles than any machine that this runs on holds; a slip of the keyboard should not exhaust its memory."""


SHORTEST = 3
"""Letters of a name's end that stand for it."""


def spelled(name: str) -> str:
    """Return a name as it is compared: no case, hyphens or spaces, and without what all of a kind end in."""
    plain = re.sub(r"[\s_-]", "", name).lower()
    for ending in ("particlefilter", "filter", "smoother", "resampling", "proposal"):
        if plain.endswith(ending) and plain != ending:
            plain = plain[: -len(ending)]
    return plain


def file_name(choice: Any) -> str:
    """Return what a run of a chosen filter is called, such as "ensemble_kalman"."""
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z0-9]+", choice if isinstance(choice, str) else choice[KIND])
    plain = [word.lower() for word in words]
    return "_".join(plain[:-1] if plain[-1:] == ["filter"] and len(plain) > 1 else plain) or "filter"


def kinds(base: type) -> dict[str, type]:
    """Return the records of a kind that a user can name, by the name of their class."""
    rooms = [importlib.import_module(room) for room in ROOMS]
    found = [getattr(room, name) for room in rooms for name in room.__all__]
    return {one.__name__: one for one in found if inspect.isclass(one) and issubclass(one, base) and not inspect.isabstract(one)
            and dataclasses.is_dataclass(one)}  # fmt: skip


def _initials(name: str) -> str:
    return "".join(filter(str.isupper, name)).lower()


def build(base: type, choice: Any, place: str, n: int | None = None) -> Any:
    """Return the record that a choice names.

    Args:
        base: what it must be: `Filter`, `Smoother`, `Scheme`, ...
        choice: a name, or a table with `kind` and parameters.
        place: where it stands, for messages.
        n: number of particles where the choice gives none and the kind asks for one.

    Raises:
        MotesError: there is no such kind or parameter, or a value cannot be used; the message names the place.
    """
    table = {KIND: choice} if isinstance(choice, str) else dict(choice) if isinstance(choice, dict) else None
    if table is None or not isinstance(table.get(KIND), str):
        refuse(place, f"a name, or a table with {KIND} = a name", shown(choice))
    known = kinds(base)
    short = {spelled(name): one for name, one in known.items()}
    ending = [one for name, one in short.items() if name.endswith(spelled(table[KIND])) and len(spelled(table[KIND])) >= SHORTEST]
    initials = [one for name, one in known.items() if len(table[KIND]) > 1 and _initials(name) == table[KIND].lower()]
    only = [one[0] for one in (ending, initials) if len(one) == 1]
    kind = known.get(table[KIND]) or short.get(spelled(table[KIND])) or next(iter(only), None)
    if kind is None:
        close = difflib.get_close_matches(spelled(table[KIND]), short, 5, 0.4)
        near = [spelled(one.__name__) for one in initials] or close or sorted(short)[:12]
        refuse(f"{place} {KIND}", f"the name of a {base.__name__}, such as {', '.join(near)}", shown(table[KIND]))
    fields = {field.name: field for field in dataclasses.fields(kind) if field.init is not False}
    given = {name: value for name, value in table.items() if name != KIND}
    if n is not None and "n" in fields:
        given.setdefault("n", n)
    unknown = sorted(set(given) - set(fields))
    if unknown:
        refuse(f"{place}", f"parameters of {kind.__name__}: {', '.join(fields) or 'none'}", shown(unknown[0]), perhaps(unknown[0], fields))
    missing = [name for name, field in fields.items() if field.default is dataclasses.MISSING
               and field.default_factory is dataclasses.MISSING and name not in given]  # fmt: skip
    if missing:
        refuse(f"{place} {missing[0]}", f"a value, which {kind.__name__} asks for", "none", f"Give --{place}.{missing[0]}.")
    many = given.get("n")
    if isinstance(many, int) and many > MOST:
        refuse(f"{place} n", f"at most {MOST} particles", many)
    hints = typing.get_type_hints(kind)
    whole = {name: _whole(value, fields[name].default) for name, value in given.items()}
    return kind(**{name: _field_value(hints[name], value, f"{place} {name}") for name, value in whole.items()})


def _whole(value: Any, default: Any) -> Any:
    """Return a choice; a table without a kind changes what is there by default."""
    if isinstance(value, dict) and KIND not in value and dataclasses.is_dataclass(default):
        return choice_of(default) | value
    return value


def _field_value(hint: Any, value: Any, place: str) -> Any:
    """Return a value in the kind of its field."""
    options = typing.get_args(hint) if isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union else (hint,)
    if value in ("none", "None") and types.NoneType in options:
        return None
    records = [one for one in options if inspect.isclass(one) and (dataclasses.is_dataclass(one) or inspect.isabstract(one))]
    if records and isinstance(value, (str, dict)):
        return build(records[0], value, place)
    if isinstance(value, dict) and any(typing.get_origin(one) is Mapping for one in options):
        return value
    plain = [one for one in options if one in (int, float, str, bool)]
    if float in plain and type(value) is int:
        return float(value)
    if type(value) in plain:
        return value
    if any(typing.get_origin(one) is tuple or one is tuple for one in options) and isinstance(value, (list, tuple, str, int, float)):
        return tuple(value) if isinstance(value, (list, tuple)) else (value,)
    wanted = [*(KINDS[one] for one in plain), *(f"a {one.__name__}" for one in records)]
    refuse(place, " or ".join(wanted) or "another value", shown(value))


def flags_of(words: Sequence[str], roots: Sequence[str]) -> tuple[dict[str, Any], list[str]]:
    """Take the flags out of the words that choose records: `--filter NAME`, `--filter.PARAMETER VALUE`.

    Returns:
        A table for each root that was named, with tables inside; and the other words.

    Raises:
        MotesError: a flag has no value, or comes twice.
    """
    found: dict[str, Any] = {}
    rest, at = [], 0
    while at < len(words):
        word, _, value = words[at].partition("=")
        root = word[2:].split(".")[0] if word.startswith("--") else ""
        if root not in roots:
            rest.append(words[at])
            at += 1
            continue
        if "=" not in words[at]:
            if at + 1 >= len(words):
                refuse(word, "a value after it", "nothing")
            value, at = words[at + 1], at + 1
        place = word[2:].split(".") + ([KIND] if word.count(".") == 0 else [])
        _put(found, place, _literal(value), word)
        at += 1
    return found, rest


def _put(table: dict[str, Any], place: list[str], value: Any, flag: str) -> None:
    for name in place[:-1]:
        inner = table.get(name)
        table[name] = inner if isinstance(inner, dict) else {} if inner is None else {KIND: inner}
        table = table[name]
    if isinstance(table.get(place[-1]), dict):
        table, place = table[place[-1]], [KIND]
    if place[-1] in table:
        refuse(flag, "one value", f"{shown(table[place[-1]])} and {shown(value)}")
    table[place[-1]] = value


def _literal(text: str) -> Any:
    """Return a value as TOML has it, or the text itself: 3, 0.5, true, [1, 2], vx,vy."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text.split(",") if "," in text else text


def merged(table: Any, flags: Any) -> Any:
    """Return the choice of a file with what flags change of it; another kind begins anew."""
    if not isinstance(flags, dict):
        return flags
    if not isinstance(table, (str, dict, types.NoneType)):
        return flags or table
    base = {KIND: table} if isinstance(table, str) else dict(table or {})
    if KIND in flags and spelled(str(flags[KIND])) != spelled(str(base.get(KIND, flags[KIND]))):
        base = {}
    return {**base, **{name: merged(base.get(name), value) if isinstance(value, dict) else value for name, value in flags.items()}}


def with_size(filters: dict[str, Any], n: int) -> dict[str, Any]:
    """Return filters with n particles, those that have any.

    Raises:
        MotesError: none has, or there are too many.
    """
    if n > MOST:
        refuse("n", f"at most {MOST} particles", n)
    if all(one.particle_count is None for one in filters.values()):
        refuse("n", "filters with particles", ", ".join(filters))
    return {name: one if one.particle_count is None else one.with_particles(n) for name, one in filters.items()}


def choice_of(record: Any) -> dict[str, Any]:
    """Return the table that chooses a record: its kind, and the parameters that are not as they are by default."""
    found: dict[str, Any] = {KIND: type(record).__name__}
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if field.init and not (value == field.default and type(value) is type(field.default)):
            found[field.name] = choice_of(value) if dataclasses.is_dataclass(value) else value
    return found


def is_spelled(choice: Any) -> bool:
    """Whether a table that chooses a record can be written: functions, which an application brings along, cannot."""
    return all(map(is_spelled, choice.values())) if isinstance(choice, dict) else not callable(choice)
