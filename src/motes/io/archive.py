"""Archives: trees of arrays in NumPy's zip format with checksums, and xarray datasets; written whole or not at all, never pickled."""

import contextlib
import io
import json
import os
import platform
import secrets
import zipfile
import zlib
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any, BinaryIO

import jax
import jax.numpy as jnp
import numpy as np

from motes.core.checks import FileError, need, refuse

_FORMAT = 1
_HEADER = "header.json"
_LARGEST_HEADER = 1 << 20


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
    temporary = None
    try:
        name = path.with_name(f".{path.name[:80]}.{secrets.token_hex(8)}")
        with name.open("xb") as file:
            temporary = name
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
        temporary = None
        _force(path.parent)
    except OSError as reason:
        refuse(str(path), "a file that can be written", reason.strerror or str(reason), error=FileError)
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


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
    """Force the names in a folder to disk."""
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
    sums = {name: zlib.crc32(np.ascontiguousarray(array).tobytes()) for name, array in arrays.items()}
    header = {"format": _FORMAT, "kind": kind, "texts": texts, "crc32": sums, "provenance": provenance()}
    with whole_file(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(_HEADER, json.dumps(header))
        for name, array in arrays.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, array, allow_pickle=False)
            archive.writestr(f"{name}.npy", buffer.getvalue())
    return path


def read_tree(path: Path, kind: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read a tree back as nested dictionaries of arrays, with its texts.

    Raises:
        FileError: the file is missing, of another kind or a newer format, or damaged.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            header = _header(path, archive, kind)
            arrays = {name: _array(path, archive, name, crc) for name, crc in header["crc32"].items()}
    except FileNotFoundError:
        refuse(str(path), f"a {kind} file", "no such file", error=FileError)
    except OSError as reason:
        refuse(str(path), f"a readable {kind} file", reason.strerror or str(reason), error=FileError)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, KeyError, TypeError, AttributeError) as reason:
        refuse(str(path), f"an undamaged {kind} file", f"{type(reason).__name__}: {reason}", "Restore it from a copy.", FileError)
    tree: dict[str, Any] = {}
    for name, array in arrays.items():
        *folders, last = name.split("/")
        place = tree
        for folder in folders:
            place = place.setdefault(folder, {})
        place[last] = array
    return tree, header["texts"]


def _header(path: Path, archive: zipfile.ZipFile, kind: str) -> dict[str, Any]:
    if archive.getinfo(_HEADER).file_size > _LARGEST_HEADER:
        refuse(f"{path}: header", f"at most {_LARGEST_HEADER} bytes", archive.getinfo(_HEADER).file_size, error=FileError)
    try:
        header = json.loads(archive.read(_HEADER))
    except ValueError:
        refuse(f"{path}: header", "JSON", "something else", "Restore it from a copy.", FileError)
    if header["kind"] != kind:
        refuse(f"{path}: kind", kind, header["kind"], error=FileError)
    if header["format"] != _FORMAT:
        refuse(f"{path}: format", f"version {_FORMAT}", f"version {header['format']}", "Read it with a newer motes.", FileError)
    return header


def _array(path: Path, archive: zipfile.ZipFile, name: str, crc: int) -> np.ndarray:
    try:
        array = np.lib.format.read_array(io.BytesIO(archive.read(f"{name}.npy")), allow_pickle=False)
    except (ValueError, MemoryError) as reason:
        refuse(f"{path}: {name}", "an array", str(reason), "Restore it from a copy.", FileError)
    if zlib.crc32(np.ascontiguousarray(array).tobytes()) != crc:
        refuse(f"{path}: {name}", "the checksum it was written with", "another", "Restore it from a copy.", FileError)
    return array


def fill(path: Path, like: Any, tree: dict[str, Any]) -> Any:
    """Give arrays read from a file the form of `like` (a tree of shapes and types).

    Raises:
        FileError: an array is missing, or has another shape or type; the message names it.
    """
    places, form = jax.tree_util.tree_flatten_with_path(like)
    leaves = []
    for where, expected in places:
        name = _name(where)
        found: Any = tree
        for part in name.split("/"):
            found = found.get(part) if isinstance(found, dict) else None
        if found is None or found.shape != expected.shape or found.dtype != expected.dtype:
            given = "nothing" if found is None else f"{found.dtype}{list(found.shape)}"
            refuse(f"{path}: {name}", f"{expected.dtype}{list(expected.shape)}", given, "Give the filter and model it was saved with.",
                   FileError)
        leaves.append(jnp.asarray(found))
    return jax.tree.unflatten(form, leaves)


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
