"""What makes two experiments the same, so that runs of one may be added to those of the other."""

from dataclasses import fields
from typing import Any

from motes.core import engine
from motes.filters.setup import canonical_parts
from motes.io.archive import provenance
from motes.models.canonical import canonical
from motes.studies.experiment import Experiment
from motes.studies.store import Entry
from motes.tracing.fingerprint import fingerprint

COMPARED = ("motes_version", "jax_version", "device", "float")
"""Provenance that may change the last bits of a run."""


def of_world(experiment: Experiment) -> dict[str, Entry]:
    """Return what all runs have in common, by name.

    Raises:
        MotesError: a function of the model cannot be compared by its traced program.
    """
    u, y = experiment.shapes()
    model = canonical(experiment.model, u, y)
    found = {}
    for name in (field.name for field in fields(model)):
        found[f"model {name}"] = _entry(f"model {name}", getattr(model, name), getattr(experiment.model, name))
    for name in ("steps", "seed", "blocks"):
        text = repr(getattr(experiment, name))
        found[name] = Entry(text, text)
    for name in ("inputs", "track"):
        given = getattr(experiment, name)
        found[name] = _entry(name, given, given)
    made_by = provenance() | {"engine": engine.chosen()}
    return found | {name.replace("_", " "): Entry(made_by[name], made_by[name]) for name in (*COMPARED, "engine")}


def of_filters(experiment: Experiment) -> dict[str, Entry]:
    """Return what tells one filter from another, by name.

    Raises:
        MotesError: a function of a filter or of the model it assumes cannot be compared by its traced program.
    """
    u, y = experiment.shapes()
    found = {}
    for name, given in experiment.filters.items():
        filter, model = canonical_parts(*experiment.assumed(name), u, y)
        found[name] = _entry(f"filter {name!r}", (filter, model) if isinstance(given, tuple) else filter, experiment.assumed(name)[0])
    return found


def _entry(name: str, value: Any, given: Any) -> Entry:
    return Entry(fingerprint(f"store: {name}", value), repr(given)[:2000])
