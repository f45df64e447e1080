"""Archives: trees of arrays in NumPy's zip format with checksums, and xarray datasets; written whole or not at all, never pickled."""

import contextlib
import io
import json
import os
import platform
import secrets
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from importlib import metadata
from pathlib import Path
from types import EllipsisType
from typing import Any, BinaryIO, NoReturn

import jax
import jax.numpy as jnp
import numpy as np

from motes.core.checks import FileError, need, refuse
from motes.io.files import look, reject
from motes.io.members import LARGEST, PACKED, Form, Members, opened, too_large, unpacked
from motes.io.unfinished import unfinished

_FORMAT = 1
POSIX = os.name == "posix"
_HEADER = "header.json"
_LARGEST_HEADER = 1 << 20
_NUMBERS = "biufc"
KINDS = {"f": "real numbers", "iu": "whole numbers", "iuf": "numbers", "b": "true or false"}
"""Kind of an array, as NumPy has it, to what messages call it."""

Shape = tuple[int | EllipsisType | None, ...]
Check = Callable[[dict[str, Any], dict[str, Any]], None]


def provenance() -> dict[str, str]:
    """Say what made a result: versions, device, precision."""
    names = ("motes", "jax", "numpy")
    found = {f"{name}_version": metadata.version(name) for name in names}
    device = jax.devices()[0]
    return found | {
        "python_version": platform.python_version(),
        "device": f"{device.platform} {device.device_kind}",
        "float": str(jnp.result_type(float)),
    }


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """Write a file so that it appears complete and on disk, or not at all.

    Raises:
        FileError: the folder is missing or cannot be written to, or the disk is full.
    """
    if "\0" in str(path):
        reject(path, "a name of a file", repr(str(path)[-80:]))
    try:
        with unfinished(path.with_name(f".{path.name[:80]}.{secrets.token_hex(8)}")) as temporary:
            with temporary.open("xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
        _force(path.parent)
    except OSError as reason:
        reject(path, "a file that can be written", reason.strerror or str(reason))


def durable_folder(path: Path) -> None:
    """Make a folder, and those above it, where they are missing, so that not even a loss of power takes them.

    Raises:
        OSError: it cannot be made, or is a file.
    """
    if path.is_dir():
        return
    durable_folder(path.parent)
    path.mkdir(exist_ok=True)
    _force(path.parent)


def _force(folder: Path) -> None:
    """Force the names in a folder to disk; Windows has no such thing for folders."""
    if not POSIX:
        return
    opened = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


def path_names(path: tuple[Any, ...]) -> list[str]:
    """Return the names along JAX's path to a leaf of a tree."""
    return [str(getattr(key, "name", getattr(key, "key", getattr(key, "idx", key)))) for key in path]


def _name(path: tuple[Any, ...]) -> str:
    return "/".join(path_names(path))


def npz_path(path: str | Path) -> Path:
    """Return the path of a file that is to be written.

    Raises:
        FileError: its name does not end in `.npz`.
    """
    path = Path(path)
    if path.suffix != ".npz":
        refuse(str(path), "a name that ends in .npz", path.suffix or "no ending", error=FileError)
    return path


def write_tree(path: Path, tree: Any, texts: dict[str, Any], kind: str) -> Path:
    """Write a tree of arrays.

    Args:
        path: file to write, ending in .npz.
        tree: records, tuples and dictionaries of arrays.
        texts: what JSON can hold, to come back with it.
        kind: word that says what the file is; asked for when reading.

    Raises:
        FileError: the file cannot be written.
    """
    arrays = {_name(where): np.asarray(leaf) for where, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]}
    sums = {name: _sum(array) for name, array in arrays.items()}
    header = {"format": _FORMAT, "kind": kind, "texts": texts, "crc32": sums, "provenance": provenance()}
    with whole_file(path) as file:
        if too_large(*_pack(file, header, arrays, zipfile.ZIP_DEFLATED)):
            # numbers that shrink so much would be refused as a trap when they are read
            file.seek(0)
            file.truncate()
            _pack(file, header, arrays, zipfile.ZIP_STORED)
    return path


def _pack(file: BinaryIO, header: dict[str, Any], arrays: dict[str, np.ndarray], method: int) -> tuple[int, int]:
    """Write all members, and return the bytes that they unpack to and those that they take."""
    with zipfile.ZipFile(file, "w", method) as archive:
        archive.writestr(_HEADER, json.dumps(header))
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
        return unpacked(archive)


def read_tree(path: Path, kind: str, check: Check | None = None) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read a tree back as nested dictionaries of arrays, with its texts.

    Nothing is allocated for an array before its header was compared with its size in the file and, all headers together, with `check`.

    Args:
        path: the file.
        kind: what the file must be.
        check: is given what the headers say, as nested dictionaries of `Form` (with shape and dtype), and the texts; it refuses what does
            not fit, by `agree` and `fit`.

    Raises:
        FileError: the file is missing, of another kind or a newer format, damaged, made to exhaust memory, or not as `check` wants it.
    """
    path = Path(path)
    look(path, 1)
    with opened(path, f"an undamaged {kind} file") as members:
        header = _header(path, members, kind)
        forms = {name: _form(path, members, name) for name in header["crc32"]}
        full, packed = members.sizes
        if too_large(full, packed):
            reject(path, f"at most {LARGEST} bytes, or {PACKED} times those of the file, when unpacked", f"{full} bytes")
        nested = _nested(forms)
        if check is not None:
            check(nested, header["texts"])
        return _nested({name: _read_array(path, members, name, crc) for name, crc in header["crc32"].items()}), header["texts"]


def _nested(leaves: dict[str, Any]) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for name, leaf in leaves.items():
        *folders, last = name.split("/")
        place = tree
        for folder in folders:
            place = place.setdefault(folder, {})
            if not isinstance(place, dict):
                raise ValueError(f"an array and a folder are both named {folder!r}")
        if last in place:
            raise ValueError(f"an array and a folder are both named {last!r}")
        place[last] = leaf
    return tree


def _header(path: Path, members: Members, kind: str) -> dict[str, Any]:
    try:
        header = json.loads(members.text(_HEADER, _LARGEST_HEADER))
    except ValueError as reason:
        if isinstance(reason, FileError):
            raise
        reject(f"{path}: header", "JSON", "something else", "Restore it from a copy.")
    for name, form in (("kind", str), ("format", int), ("texts", dict), ("crc32", dict)):
        if not isinstance(header, dict) or not isinstance(header.get(name), form):
            reject(f"{path}: header", f"its {name!r}", "none", "Restore it from a copy.")
    if header["kind"] != kind:
        reject(f"{path}: kind", kind, header["kind"][:80])
    if header["format"] != _FORMAT:
        reject(f"{path}: format", f"version {_FORMAT}", f"version {header['format']}", "Read it with a newer motes.")
    return header


def _form(path: Path, members: Members, name: str) -> Form:
    form = members.form(name)
    if form.dtype.kind not in _NUMBERS:
        reject(f"{path}: {name}", "an array of numbers", f"{form.dtype}{list(form.shape)}", "Restore it from a copy.")
    return form


def _read_array(path: Path, members: Members, name: str, crc: int) -> np.ndarray:
    array = members.read(name)
    if _sum(array) != crc:
        reject(f"{path}: {name}", "the checksum it was written with", "another", "Restore it from a copy.")
    return array.astype(array.dtype.newbyteorder("="), copy=False)


def _sum(array: np.ndarray) -> int:
    return zlib.crc32(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)


def agree(path: Path, tree: dict[str, Any], wanted: Mapping[str, tuple[Shape, str]]) -> None:
    """Refuse a tree in which an array is missing or has another shape or kind than wanted.

    Args:
        path: the file, for the message.
        tree: nested dictionaries of arrays, or of what their headers say.
        wanted: shape and kind of arrays by name, with slashes: in shapes None is any length, and `...` at the end any further axes; the
            kind is one of `KINDS`.

    Raises:
        FileError: naming the first array that does not fit.
    """
    for name, (shape, kind) in wanted.items():
        found = _at(tree, name)
        if found is None or isinstance(found, dict) or found.dtype.kind not in kind or not _matches(tuple(found.shape), shape):
            sizes = ", ".join("any" if length is None else "..." if length is ... else str(length) for length in shape)
            _unfit(path, name, f"{KINDS[kind]} of shape ({sizes})", found)


def _matches(given: tuple[int, ...], wanted: Shape) -> bool:
    fixed = wanted[:-1] if wanted[-1:] == (...,) else wanted
    long = len(given) == len(fixed) or (fixed != wanted and len(given) > len(fixed))
    return long and all(length in (None, there) for length, there in zip(fixed, given, strict=False))


def repeats(path: Path, tree: dict[str, Any], name: str, ahead: tuple[int, ...], of: str, before: tuple[int, ...]) -> None:
    """Refuse a tree in which what stands under one name is not what stands under another, with other axes in front.

    Args:
        path: the file, for the message.
        tree: nested dictionaries of arrays, or of what their headers say.
        name: of an array or a folder, with slashes.
        ahead: its axes in front.
        of: name of the other.
        before: axes in front of the other.

    Raises:
        FileError: naming the first array that does not fit.
    """
    model = _leaves(_at(tree, of), of)
    for place, found in _leaves(_at(tree, name), name).items():
        other = model.pop(of + place[len(name) :], None)
        if other is None or other.shape[: len(before)] != before:
            _unfit(path, of + place[len(name) :], f"an array with the axes {list(before)} in front", other)
        if found.shape != ahead + other.shape[len(before) :] or found.dtype != other.dtype:
            _unfit(path, place, f"{other.dtype}{[*ahead, *other.shape[len(before) :]]} as in {of!r}", found)
    for place in model:
        _unfit(path, name + place[len(of) :], f"an array as {place!r}", None)


def _leaves(tree: Any, name: str) -> dict[str, Any]:
    if not isinstance(tree, dict):
        return {} if tree is None else {name: tree}
    return {place: leaf for key, part in tree.items() for place, leaf in _leaves(part, f"{name}/{key}").items()}


def fit(path: Path, like: Any, tree: dict[str, Any]) -> list[Any]:
    """Return the arrays of a tree, or what their headers say, in the order of the leaves of `like` (a tree of shapes and types).

    Raises:
        FileError: an array is missing, or has another shape or type; the message names it.
    """
    found = []
    for where, expected in jax.tree_util.tree_flatten_with_path(like)[0]:
        leaf = _at(tree, _name(where))
        if leaf is None or isinstance(leaf, dict) or leaf.shape != expected.shape or leaf.dtype != expected.dtype:
            _unfit(path, _name(where), f"{expected.dtype}{list(expected.shape)}", leaf)
        found.append(leaf)
    return found


def fill(path: Path, like: Any, tree: dict[str, Any]) -> Any:
    """Give arrays read from a file the form of `like` (a tree of shapes and types).

    Raises:
        FileError: an array is missing, or has another shape or type; the message names it.
    """
    return jax.tree.unflatten(jax.tree.structure(like), [jnp.asarray(leaf) for leaf in fit(path, like, tree)])


def _at(tree: dict[str, Any], name: str) -> Any:
    found: Any = tree
    for part in name.split("/"):
        found = found.get(part) if isinstance(found, dict) else None
    return found


def _unfit(path: Path, name: str, expected: str, found: Any) -> NoReturn:
    given = "nothing" if found is None else "a folder" if isinstance(found, dict) else f"{found.dtype}{list(found.shape)}"
    reject(f"{path}: {name}", expected, given, "Give the filter and model it was saved with, or restore it from a copy.")


def write_dataset(path: Path, dataset: Any) -> Path:
    """Write an xarray dataset as NetCDF, whole or not at all (extra `results`).

    Raises:
        FileError: the file cannot be written.
    """
    need("h5netcdf", "results")
    for name, values in dataset.data_vars.items():
        if values.dtype == bool:
            dataset[name] = values.astype("int8")
    with whole_file(path) as file:
        buffer = io.BytesIO()
        dataset.to_netcdf(buffer, engine="h5netcdf")
        file.write(buffer.getvalue())
    return path
