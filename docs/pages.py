"""Writes how-to-choose.md and a page for each method under methods/, from what these say of themselves: python docs/pages.py."""

import dataclasses
import inspect
import re
import tomllib
from pathlib import Path

import motes as mo

HERE = Path(__file__).parent
EQUATIONS = tomllib.loads((HERE / "equations.toml").read_text())
HEAD = """# How to choose a filter

Written by `python docs/pages.py` from the filters themselves. `x` is the number of states, `n` that of particles.

1. Look at the model: `print(mo.structure(model))`. All states linear: `KalmanFilter`; some: rather `MarginalizedParticleFilter` than
   `ParticleFilter`.
2. One mode and functions that bend little: try a Gaussian filter first; it costs what one particle does.
3. One or two states: run `PointMassFilter` once; it tells what could be had.
4. With a clock or an accuracy in mind let `mo.plan(model, budget=...)` choose filter, partition and number of particles.
5. Run, then ask `print(mo.diagnose(history))`; it says in words when a run is not to be trusted and what to try.

| filter | needs of the model | cost of a step | likelihood | looks ahead | when to use |
| --- | --- | --- | --- | --- | --- |
"""


def methods():
    """Return the public filters and smoothers by name."""
    kinds = (mo.Filter, mo.smoothers.Smoother)
    found = {name: getattr(room, name) for room in (mo, mo.smoothers) for name in room.__all__}
    return {name: cls for name, cls in found.items()
            if inspect.isclass(cls) and issubclass(cls, kinds) and not inspect.isabstract(cls) and cls.__name__ == name}  # fmt: skip


def look_ahead(cls):
    """Say whether a filter moves only when it knows the measurement."""
    return "by its parameters" if isinstance(inspect.getattr_static(cls, "look_ahead"), property) else "yes" if cls.look_ahead else "no"


def choice():
    """Return the text of how-to-choose.md."""
    rows = []
    for name, cls in methods().items():
        if issubclass(cls, mo.Filter):
            likelihood = "yes" if cls.has_evidence else "no"
            cells = (f"[`{name}`](methods/{name}.md)", cls.guide.needs, cls.guide.cost, likelihood, look_ahead(cls), cls.guide.use)
            rows.append(f"| {' | '.join(cells)} |\n")
    smoothers = [f"[`{name}`](methods/{name}.md)" for name, cls in methods().items() if issubclass(cls, mo.smoothers.Smoother)]
    past = f"States of the past given all measurements: `mo.smooth` with {', '.join(smoothers)}; see [smoothers](smoothers.md)."
    return f"{HEAD}{''.join(rows)}\n{past}\n"


def page(name, cls):
    """Return the text of a method's own page."""
    method = inspect.getdoc(inspect.getmodule(cls))
    about, source, example = parts(cls)
    defaults = {field.name: field.default for field in dataclasses.fields(cls)}
    table = "".join(f"| `{parameter}` | {' '.join(text.split())} | {shown(defaults[parameter])} |\n"
                    for parameter, text in parameters(cls).items())  # fmt: skip
    table = f"\n| parameter | meaning | default |\n| --- | --- | --- |\n{table}" if table else ""
    guide = f"\nNeeds: {cls.guide.needs}. Cost of a step: {cls.guide.cost}. Use: {cls.guide.use}.\n" if issubclass(cls, mo.Filter) else ""
    shows = f"```python\n{code(example)}```\n"
    math = "".join(f"\n$$\n{equation}\n$$\n" for equation in EQUATIONS[name].strip().split("\n\n"))
    seen = f"![The first state of the example over its steps, with the truth]({name}.png)"
    return f"# `{name}`\n\n{method}\n{math}\n{shows}\n{seen}\n\n## Parameters\n\n{about}\n{table}{guide}\n{source}\n"


def parts(cls):
    """Return what a class says of itself before its parameters: description, source, example."""
    text = inspect.getdoc(cls).partition("\nAttributes:\n")[0]
    about, _, rest = text.partition("\nSource: ")
    source, _, example = rest.partition("\nExample:\n")
    return about.strip(), f"Source: {source.strip()}", inspect.cleandoc(example)


def code(example):
    """Return the code of an example, with what it needs, and what it prints as a comment."""
    lines = [line[4:] if line.startswith((">>> ", "... ")) else f"# {line}" for line in example.splitlines()]
    needed = ["import jax", "import jax.numpy as jnp"] if "jax." in example else ["import jax.numpy as jnp"] if "jnp." in example else []
    return "\n".join([*needed, "import motes as mo", "", *lines, ""])


def parameters(cls):
    """Return what a method says of its parameters, by name: its own first, then those of the classes that it derives from."""
    fields, found = {field.name for field in dataclasses.fields(cls)}, {}
    for part in cls.__mro__:
        _, _, told = inspect.cleandoc(vars(part).get("__doc__") or "").partition("\nAttributes:\n")
        for name, text in re.findall(r"^ {4}(\w+): (.*?)(?=^ {4}\w+: |\Z)", told, re.S | re.M):
            if name in fields:
                found.setdefault(name, text)
    return found


def shown(default):
    """Return a default as the table shows it."""
    return "none, must be given" if default is dataclasses.MISSING else f"`{default!r}`"


def pages():
    """Return all texts by file."""
    return {HERE / "how-to-choose.md": choice()} | {HERE / "methods" / f"{name}.md": page(name, cls) for name, cls in methods().items()}


if __name__ == "__main__":
    (HERE / "methods").mkdir(exist_ok=True)
    for path, text in pages().items():
        path.write_text(text)
