"""Folders for compiled code that is kept between calls, which nobody else can write to."""

import os
import stat
from pathlib import Path


def place(name: str) -> Path:
    """Return where compiled code of one kind is kept."""
    home = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(home) if os.path.isabs(home) else Path.home() / ".cache") / "motes" / name


def private_folder(name: str) -> Path | None:
    """Return the folder for one kind, made where it was missing, or None where it cannot be written to or is not ours alone.

    What lies there is executed, so a folder that others can write to is not used.
    """
    try:
        folder = place(name)
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
            return None
        if stat.S_IMODE(found.st_mode) != 0o700:
            folder.chmod(0o700)
        return folder if os.access(folder, os.W_OK) else None
    except (OSError, RuntimeError):
        return None
