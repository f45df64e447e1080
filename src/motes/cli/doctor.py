"""`motes doctor`: what a report of a problem should say of this machine."""

import platform
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import metadata

from motes.cli.options import from_flags
from motes.core import kept


@dataclass(frozen=True)
class Doctor:
    """Print versions, devices, precision and folders."""


def main(words: Sequence[str]) -> None:
    """Print the report."""
    from_flags(Doctor(), words, "motes doctor")
    for name, value in report():
        print(f"{name:<16}{value}")


def report() -> Iterator[tuple[str, str]]:
    """Yield name and value of each line."""
    import jax

    from motes.core.engine import chosen
    from motes.native import blocks, compile
    from motes.studies.run import processors

    yield "motes", metadata.version("motes")
    yield "python", f"{platform.python_version()} ({sys.executable})"
    yield "system", f"{platform.system()} {platform.release()} {platform.machine()}"
    yield "processors", str(processors())
    yield "devices", _devices()
    yield "precision", {"float64": "float64"}.get(str(jax.numpy.result_type(float)), "float32 (set JAX_ENABLE_X64=1 for float64)")
    for kind, name in (("compiled", kept.programs()), ("native", "native")):
        found = kept.private_folder(name)
        yield f"{kind} code", str(found) if found else f"not kept: {kept.why_not(name)}"
    yield "engine", chosen()
    yield "native engine", blocks.standing(tried=True) or f"ready, compiled by {' '.join(compile.compiler())}"
    for package, extra in sorted(packages().items()):
        yield package, _version(package) or f"not installed (pip install 'motes[{extra}]')"


def _devices() -> str:
    import jax

    try:
        return ", ".join(f"{device.platform} {device.device_kind}" for device in jax.devices())
    except RuntimeError as reason:
        return f"none: {reason}"


def packages() -> dict[str, str]:
    """Return what motes can use: package to the first extra that brings it, "" for what it always needs."""
    found: dict[str, str] = {}
    for line in metadata.requires("motes") or ():
        name = re.match(r"[A-Za-z0-9._-]+", line)
        extra = re.search(r"extra\s*==\s*['\"]([^'\"]+)", line)
        group = extra[1] if extra else ""
        if name and name[0] != "motes" and group not in ("all", "test", "dev"):
            found.setdefault(name[0], group)
    return found


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
