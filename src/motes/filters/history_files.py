"""What a file must hold to be a history, checked before its arrays are read; files of older versions."""

import re
from dataclasses import fields as fields_of
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.core.logspace import RunningSum
from motes.filters.info import Info
from motes.io import archive
from motes.io.labels import Labels
from motes.io.members import Form
from motes.laws.observed import Observed
from motes.laws.spelled import UnspelledError, restored

TRAITS = ("has_evidence", "weighs", "subtracts", "particles", "engine", "descends")
"""What a file says of the filter beside its name; files of version 0.1 have not all of it."""


def read(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the fields of a history, and those of where it ended; see `History.load`.

    Raises:
        FileError: the file is no history, or is damaged.
    """
    if path.suffix == ".nc":
        checks.refuse(str(path), "a history saved as .npz", "a NetCDF file, which xarray.open_dataset reads",
                      "Save with history.save('run.npz') to load it.", checks.FileError)
    tree, texts = archive.read_tree(path, "history", lambda forms, texts: check_forms(path, forms, texts))
    mean = tree.get("kept", {}).get("mean", np.zeros(()))
    if not isinstance(mean, dict) and not np.isfinite(mean).all():
        checks.refuse(f"{path}: kept/mean", "finite numbers", "NaN or infinite ones", "Restore it from a copy.", checks.FileError)
    last, forms = dict(tree["last"]), texts.get("forms", {})
    evidence = RunningSum(**{name: jnp.asarray(value) for name, value in last["evidence"].items()})
    y = last["y"]
    y = Observed(jax.tree.map(jnp.asarray, y.get("value")), jnp.asarray(y["there"])) if isinstance(y, dict) else jnp.asarray(y)
    try:
        kept = restored(forms["kept"], tree.get("kept", {})) if "kept" in forms else tree.get("kept", {})
        state = restored(forms["state"], last.get("state")) if "state" in forms else last.get("state")
    except UnspelledError as reason:
        checks.refuse(f"{path}: forms", "those of its arrays", str(reason)[:200], "Restore it from a copy.", checks.FileError)
    if isinstance(state, dict) or isinstance(kept.get("law"), dict):
        checks.warn(f"{path}: its laws are of a kind that files of this version do not name; they come back as dictionaries of arrays. "
                    "The history can be continued, but not smoothed, and diagnose sees no weights.")
    suspicion = jnp.asarray(last.get("suspicion", 0.0), evidence.total.dtype)
    ended = {"state": state, "evidence": evidence, "suspicion": suspicion, "y": y, "u": last.get("u"), "step": jnp.asarray(last["step"])}
    fields = {"kept": kept, "info": recorded(tree["info"]), "start": jnp.asarray(tree["start"]), "label": texts["filter"]}
    fields |= {name: texts[name] for name in TRAITS if name in texts} | {name: tree.get(name) for name in ("rounding", "times")}
    fields |= {name: tuple(texts.get(name, ())) for name in ("names", "circular")}
    return fields | {"labels": restored_labels(path, tree.get("index"), texts)}, ended


def check_forms(path: Path, forms: dict[str, Any], texts: dict[str, Any]) -> None:
    """Refuse a file whose arrays cannot be those of a history, before they are read."""
    names = texts.get("names")
    named = isinstance(names, list) and all(isinstance(name, str) for name in names) and isinstance(texts.get("filter"), str)
    if not isinstance(names, list) or not named or not isinstance(texts.get("forms", {}), dict):
        checks.refuse(f"{path}: texts", "names of states and of a filter", "others", "Restore it from a copy.", checks.FileError)
    kinds = {"collapsed": "b", "alarm": "b", "invalid": "iu", "gated": "iu", "freedom": "iuf"}
    last = forms.get("last")
    archive.agree(path, forms, {"info/log_evidence": ((None,), "f"), "start": ((), "iu"), "last/step": ((), "iu"),
                                **measurement_form("last/y", last.get("y") if isinstance(last, dict) else None),
                                "last/evidence/total": ((), "f"), "last/evidence/missed": ((), "f")})  # fmt: skip
    steps, x = forms["info"]["log_evidence"].shape[0], len(names)
    always = {"ess", "collapsed", "invalid", "lowest", "highest", "shortfall"}
    there = {field.name for field in fields_of(Info)} & set(forms["info"]) | always
    archive.agree(path, forms, {f"info/{name}": ((steps,), kinds.get(name, "f")) for name in there})
    for name, kinds_of in (("times", "f"), ("index", "iuf")):
        if name in forms:
            archive.agree(path, forms, {name: ((steps,), kinds_of)})
    if set(forms["info"]) - there:
        checks.refuse(f"{path}: info", "known records of steps", sorted(set(forms["info"]) - there)[0], "Read it with a newer motes.",
                      checks.FileError)
    kept = forms.get("kept", {})
    known = {"mean": (steps, x), "cov": (steps, x, x), "mode_probabilities": (steps, None),
             "delayed_mode_probabilities": (steps, None, None)}  # fmt: skip
    archive.agree(path, forms, {f"kept/{name}": (shape, "f") for name, shape in known.items() if isinstance(kept, dict) and name in kept})
    law, state = kept.get("law") if isinstance(kept, dict) else None, last.get("state") if isinstance(last, dict) else None
    # `keep.paths` keeps laws of another kind, which have no name in common
    if isinstance(law, dict) and not (isinstance(state, dict) and state and law.keys().isdisjoint(state)):
        archive.repeats(path, forms, "kept/law", (steps,), "last/state", ())


def measurement_form(name: str, stored: Any) -> dict[str, tuple[tuple[int | None, ...], str]]:
    """Return what a file must hold of one measurement under a name: a vector, or a tree and whether there was anything."""
    return {f"{name}/there": ((), "b")} if isinstance(stored, dict) else {name: ((None,), "f")}


def recorded(fields: dict[str, Any]) -> Info:
    """Return what a file says of each step; what files of version 0.1 lack reads as not known (`freedom` 0)."""
    like = fields["log_evidence"]
    lacking = {name: np.zeros_like(like) for name in ("nis", "freedom", "lost", "recovered")}
    lacking |= {"alarm": np.zeros(like.shape, bool), "gated": np.zeros(like.shape, np.int32)}
    return Info(**{name: jnp.asarray(value) for name, value in {**lacking, **fields}.items()})


def stored_labels(labels: Labels | None) -> tuple[np.ndarray | None, dict[str, Any]]:
    """Return the index of labels as numbers, times as whole ticks, and the words that a file keeps beside it."""
    if labels is None:
        return None, {}
    index, unit = labels.index, ""
    if index is not None and index.dtype.kind in "mM":
        unit, index = index.dtype.str[1:], index.astype(np.int64)
    words = {"unit": unit, "columns": list(labels.columns), "name": labels.name, "zone": labels.zone, "period": labels.period}
    return index, {"labels": words}


def restored_labels(path: Path, index: np.ndarray | None, texts: dict[str, Any]) -> Labels | None:
    """Return the labels that a file keeps; None of one that keeps none, as those before version 0.2.

    Raises:
        FileError: they are none.
    """
    words = texts.get("labels")
    if words is None:
        return None
    named = isinstance(words, dict) and all(isinstance(words.get(name), str) for name in ("unit", "name", "zone", "period"))
    columns = words.get("columns") if named else None
    unit = words["unit"] if named else "?"
    ticks = index is not None and index.dtype.kind == "i" and re.fullmatch(r"[mM]8\[\d{0,9}(?:D|h|m|s|ms|us|ns|ps|fs|as)\]", unit)
    if not isinstance(columns, list) or not all(isinstance(column, str) for column in columns) or not (unit == "" or ticks):
        checks.refuse(f"{path}: labels", "times with a unit and names of columns", "others", "Restore it from a copy.", checks.FileError)
    index = index if not unit or index is None else index.astype(np.int64).view(unit)
    return Labels(index, tuple(columns), words["name"], words["zone"], words["period"])


def stored_shapes(tree: Any) -> Any:
    """Return the shapes of a tree of what a file holds."""
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), tree, is_leaf=lambda leaf: isinstance(leaf, Form))


def measured_shapes(stored: Any, dtype: Any) -> Any:
    """Return the shapes of a measurement that a file holds."""
    if not isinstance(stored, dict):
        return jax.ShapeDtypeStruct(stored.shape, dtype)
    shapes = stored_shapes(stored)
    return Observed(shapes.get("value"), shapes["there"])
