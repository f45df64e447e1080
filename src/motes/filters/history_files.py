"""What a file must hold to be a history, checked before its arrays are read; files of older versions."""

from dataclasses import fields
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.filters.info import Info
from motes.io import archive


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
    there = {field.name for field in fields(Info)} & set(forms["info"]) | {"ess", "collapsed", "invalid", "lowest", "highest", "shortfall"}
    archive.agree(path, forms, {f"info/{name}": ((steps,), kinds.get(name, "f")) for name in there})
    if "times" in forms:
        archive.agree(path, forms, {"times": ((steps,), "f")})
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
