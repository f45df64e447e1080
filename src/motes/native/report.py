"""What runs where: notes that native kernels leave while a filter is traced, and warnings where they were asked for and do not run."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from motes.core import checks, engine


class Notes(dict[str, str]):
    """How each stage runs and why.

    Attributes:
        kernels: whether kernels that are no stage of a filter were used: random numbers, resampling, weights, moments.
    """

    kernels = False


_notes: ContextVar[Notes | None] = ContextVar("notes", default=None)
_quiet: ContextVar[bool] = ContextVar("quiet", default=False)
_warned: set[str] = set()

FUSED, KERNELS, JAX = "native, fused", "native kernels around JAX", "JAX"
_WAYS = (FUSED, KERNELS, JAX)
ALL = "all"
"""Stands for the stages of what has none of its own on the native engine."""


def note(stage: str, way: str, why: str) -> None:
    """Leave a note on how a stage runs and why, and warn, once in a process for each, where native kernels were asked for and do not run.

    Of several notes on one stage the one that says the least for the native engine stays.
    """
    kept = _notes.get()
    if kept is not None and _WAYS.index(way) >= _WAYS.index(kept.get(stage, FUSED).partition(":")[0]):
        kept[stage] = f"{way}: {why}"
    what = "everything" if stage == ALL else f"stage {stage!r}"
    text = f"the native engine was asked for, but {what} runs {'on JAX' if way == JAX else f'as {way}'}: {why}."
    if way != FUSED and engine.chosen() == "native" and not _quiet.get() and text not in _warned:
        _warned.add(text)
        checks.warn(text)


def note_absence(why: str) -> None:
    """Say that the native engine cannot be used at all; inside of filters their stages do so."""
    if _notes.get() is None:
        note(ALL, JAX, why)


def note_kernel() -> None:
    """Note that a kernel is used that is no stage of a filter."""
    kept = _notes.get()
    if kept is not None:
        kept.kernels = True


@contextmanager
def collected(quiet: bool = False) -> Iterator[Notes]:
    """Collect the notes of what is traced inside a `with` block, by stage; without warnings if quiet."""
    notes = Notes()
    tokens = _notes.set(notes), _quiet.set(quiet)
    try:
        yield notes
    finally:
        _notes.reset(tokens[0])
        _quiet.reset(tokens[1])


def complete(notes: Notes, name: str) -> None:
    """Note how the whole runs where no stage of the named filter left a note; for use where notes are collected."""
    if not notes and engine.chosen() != "jax":
        found = (KERNELS, f"{name} has no stage that is one kernel") if notes.kernels else (JAX, f"{name} has no stage with native kernels")
        note(ALL, *found)


def engine_used(notes: Notes) -> str:
    """Return which engine did the work: "jax", "native", or "native in part"."""
    ways = {text.split(":")[0] for text in notes.values()}
    if not ways - {JAX}:
        return "jax"
    return "native" if ways == {FUSED} else "native in part"
