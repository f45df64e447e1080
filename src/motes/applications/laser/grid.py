"""Occupancy grids as the robot world's map servers keep them: a PNG image, and a flat YAML file that says what it means."""

import ast
import os
from pathlib import Path
from typing import Any

import numpy as np

from motes.core.checks import need
from motes.core.record import record
from motes.io.archive import whole_file
from motes.io.files import foreign, look, reject

KEYS = ("image", "resolution", "origin", "occupied_thresh", "free_thresh", "negate")
LARGEST = 36_000_000


@record
class Grid:
    """A map of a building.

    Attributes:
        occupied: `(rows, columns)`, row 0 the southernmost.
        free: where the robot may be, as `occupied`; what is neither is unknown.
        resolution: width of a cell, meters.
        origin: x, y of the south-west corner, meters.
    """

    occupied: np.ndarray
    free: np.ndarray
    resolution: float
    origin: tuple[float, float]


def read_grid(path: str | os.PathLike[str]) -> Grid:
    """Read a map.

    Raises:
        FileError: a file cannot be read, or a key is missing or has a value that it cannot have.
        MissingExtraError: pillow is not installed.
    """
    keys = _flat(path)
    name = keys["image"]
    if not isinstance(name, str) or not name:
        reject(path, "the name of a PNG file as image", repr(name))
    file = Path(path).parent / name
    if look(file, 8)[1] != b"\x89PNG\r\n\x1a\n":
        reject(file, "a PNG image", "another kind of file")
    image = need("PIL.Image", "results")
    with foreign(file, "an undamaged PNG image"), image.open(file) as picture:
        if picture.width * picture.height > LARGEST:
            reject(file, f"at most {LARGEST} cells", picture.width * picture.height)
        grey = np.asarray(picture.convert("L"), float)[::-1] / 255
    share = grey if keys["negate"] else 1 - grey
    free = share < keys["free_thresh"]
    if not free.any():
        reject(file, "cells that are free", "none", "Is negate right?")
    return Grid(share > keys["occupied_thresh"], free, keys["resolution"], tuple(keys["origin"][:2]))


def _flat(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the keys of a flat YAML file: numbers, lists of numbers, and names."""
    look(path, 1)
    with foreign(path, "UTF-8 text"):
        lines = Path(path).read_text("utf-8").splitlines()
    found: dict[str, Any] = {}
    for number, line in enumerate(lines, 1):
        text = line.split(" #")[0].strip()
        if not text or text.startswith("#") or text == "---":
            continue
        key, colon, value = text.partition(":")
        if not colon:
            reject(path, f'"key: value" in line {number}', repr(text[:60]))
        try:
            found[key.strip()] = ast.literal_eval(value.strip())
        except (ValueError, SyntaxError):
            found[key.strip()] = value.strip()
    missing = [key for key in KEYS if key not in found]
    if missing:
        reject(path, f"the keys {', '.join(KEYS)}", f"no {missing[0]}")
    numbers = lambda value: type(value) in (int, float) and np.isfinite(value)  # noqa: E731
    rules = {"resolution": ("a width above 0, meters", lambda v: numbers(v) and v > 0),
             "origin": ("[x, y, 0], meters", lambda v: isinstance(v, list) and len(v) == 3 and all(map(numbers, v)) and v[2] == 0),
             "free_thresh": ("a share between 0 and 1", lambda v: numbers(v) and 0 < v < 1),
             "occupied_thresh": ("a share above free_thresh, at most 1", lambda v: numbers(v) and found["free_thresh"] < v <= 1),
             "negate": ("0 or 1", lambda v: v in (0, 1))}  # fmt: skip
    for key, (expected, holds) in rules.items():
        if not holds(found[key]):
            reject(path, f"{expected} as {key}", repr(found[key])[:60])
    return found


def write_grid(path: str | os.PathLike[str], grid: Grid) -> None:
    """Write a map as `read_grid` reads it: NAME.png beside NAME.yaml."""
    shades = np.where(grid.occupied, 0, np.where(grid.free, 254, 205)).astype(np.uint8)
    picture = Path(path).with_suffix(".png")
    with whole_file(picture) as file:
        need("PIL.Image", "results").fromarray(shades[::-1]).save(file, format="png")
    x, y = grid.origin
    text = (f"image: {picture.name}\nresolution: {grid.resolution!r}\norigin: [{x!r}, {y!r}, 0.0]\n"
            "occupied_thresh: 0.65\nfree_thresh: 0.196\nnegate: 0\n")  # fmt: skip
    with whole_file(Path(path)) as file:
        file.write(text.encode())
