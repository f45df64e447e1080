"""What runs where: notes that the native engine leaves while a filter is traced."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_notes: ContextVar[dict[str, str] | None] = ContextVar("notes", default=None)

FUSED, KERNELS, JAX = "native, fused", "native kernels around JAX", "JAX"


def note(stage: str, way: str, why: str = "") -> None:
    """Leave a note on how a stage runs and why."""
    kept = _notes.get()
    if kept is not None:
        kept[stage] = f"{way}: {why}" if why else way


@contextmanager
def collected() -> Iterator[dict[str, str]]:
    """Collect the notes of what is traced inside a `with` block, by stage."""
    notes: dict[str, str] = {}
    token = _notes.set(notes)
    try:
        yield notes
    finally:
        _notes.reset(token)


def summary(notes: dict[str, str]) -> str:
    """Return which engine did the work: "jax", "native", or "native in part"."""
    ways = {text.split(":")[0] for text in notes.values()}
    if not ways - {JAX}:
        return "jax"
    return "native" if ways == {FUSED} else "native in part"
