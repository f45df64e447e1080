"""Files and folders that are being made: known, so that a process that ends at once leaves none of them behind."""

import contextlib
import glob
import shutil
from collections.abc import Iterator
from pathlib import Path

_places: set[Path] = set()


@contextlib.contextmanager
def unfinished(path: Path) -> Iterator[Path]:
    """Know of a file or folder until it is finished; what is still there under its name then is removed."""
    _places.add(path)
    try:
        yield path
    finally:
        _remove(path)
        _places.discard(path)


def remove_unfinished() -> None:
    """Remove whatever is being made; only before the process ends."""
    for path in list(_places):
        with contextlib.suppress(OSError):
            _remove(path)


def remove_leftovers(path: Path) -> None:
    """Remove what a killed process left of a file that it was making (see `archive.whole_file`); only where no other makes it now."""
    for place in path.parent.glob(f".{glob.escape(path.name[:80])}.{16 * '[0-9a-f]'}"):
        with contextlib.suppress(OSError):
            _remove(place)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
