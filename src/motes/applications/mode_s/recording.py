"""Radio recordings as files of I and Q in turn."""

from pathlib import Path

import numpy as np

from motes.applications.mode_s.preambles import LONGEST
from motes.core import checks

RATE = 2_000_000
"""Samples a second."""
_FORMS = {"unsigned8": (np.dtype(np.uint8), 127.5), "signed16": (np.dtype("<i2"), 0.0)}


def read_samples(path: str | Path, samples: str) -> np.ndarray:
    """Read complex samples `(t,)`, in units of the file.

    A file that ends within a sample is read up to there, and a line says so.

    Raises:
        FileError: it cannot be read, or is shorter than a message.
    """
    form, middle = _FORMS[samples]
    try:
        raw = np.fromfile(path, np.uint8)
    except (OSError, ValueError) as reason:
        checks.refuse(f"{path!r}", "a file that can be read", str(getattr(reason, "strerror", None) or reason), "", checks.FileError)
    size = 2 * form.itemsize
    count, over = divmod(len(raw), size)
    if count < LONGEST:
        wanted = f"I and Q of at least {LONGEST} samples, {size} bytes each"
        checks.refuse(f"{path}", wanted, f"{len(raw)} bytes", "Give a recording at 2 million samples a second.", checks.FileError)
    if over:
        checks.warn(f"{path}: ends {over} bytes into a sample ({len(raw)} bytes, {size} to a sample); these are left out.")
    pairs = raw[: count * size].view(form).reshape(-1, 2).astype(np.float32) - np.float32(middle)
    return pairs[:, 0] + 1j * pairs[:, 1]


def write_samples(path: Path, samples: np.ndarray, form: str) -> None:
    """Write complex samples as a receiver does, rounded and clipped."""
    kind, middle = _FORMS[form]
    limits = np.iinfo(kind)
    pairs = np.stack([np.real(samples), np.imag(samples)], axis=1) + middle
    np.clip(np.round(pairs), limits.min, limits.max).astype(kind).tofile(path)
