"""What documents and classes show as code runs: by day with smaller numbers where it would take long, by night as it stands."""

import contextlib
import doctest
import inspect
import io
import re
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

import motes as mo
from test_documents import ROOT
from tiers import NIGHT, but_one_in, each

PAGES = [path for path in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md")),
                           *sorted((ROOT / "docs" / "tutorials").glob("*.md")))
         if re.search(r"^```(python|\{code-cell\})$", path.read_text(), re.M)]  # fmt: skip
FEWER = (("n=2_574", "n=64"), ("n=2_000", "n=64"), ("steps=100", "steps=8"))
TUTORIALS = {path.name for path in PAGES if path.parent.name == "tutorials"}
BY_NIGHT = {"bounds.md", "chains.md", "coming-from.md", "CONTRIBUTING.md", "cookbook.md", "parameters.md", "scale.md", "studies.md"}
BY_NIGHT |= TUTORIALS
"""Pages that take long, of what other tests run, too."""
SMALLER = {
    "README.md": (
        *FEWER, ("runs=100", "runs=2"), ("draws=1_000", "draws=100"), ("n=1_000", "n=64"),
        ('mo.plan(model, budget=1e-3, states=("px", "py"))',
         'mo.planning.Plan(mo.KalmanFilter(), 1e-3, mo.io.Table(("filter",), (("it",),)))'),
    ),
    "chains.md": (("draws=5_000", "draws=100"),),
    "parameters.md": (("draws=5_000", "draws=10"), ("steps=100", "steps=10")),
    "smoothers.md": (("steps=100", "steps=10"),),
    "studies.md": (*FEWER, ("runs=100", "runs=2")),
}  # fmt: skip
"""Text that is exchanged by day, by page; each must be there."""


def blocks(text):
    """Each piece of Python in a page, and what it must print (None: nothing is said of that)."""
    fences = list(re.finditer(r"^```([\w{}-]*)\n(.*?)^```\n+", text, re.S | re.M))
    for place, fence in enumerate(fences):
        after = fences[place + 1] if place + 1 < len(fences) else None
        if fence[1] in ("python", "{code-cell}"):
            yield fence[2], after[2] if after and not after[1] and after.start() == fence.end() else None


def smaller(page):
    """Text of a page, by day with smaller numbers."""
    text = page.read_text()
    for long, short in () if NIGHT else SMALLER.get(page.name, ()):
        assert long in text, long
        text = text.replace(long, short)
    return text


@pytest.fixture(autouse=True)
def _precision_as_before():
    """Pages show how precision is switched; the tests after them do not ask for that."""
    before = jax.config.jax_enable_x64
    yield
    jax.config.update("jax_enable_x64", before)


@pytest.mark.parametrize("page", each({path.name: path for path in PAGES}, BY_NIGHT))
def test_code_of_a_page_runs_in_order(page, tmp_path, monkeypatch):
    """All in one namespace; a piece that begins with the name of a file is that file, which is run if it is a program."""
    monkeypatch.chdir(tmp_path)
    names = {"__name__": page.stem}
    for code, printed in blocks(smaller(page)):
        file = re.match(r"# (\w+\.py)\n", code)
        if file:
            Path(file[1]).write_text(code)
            if "__main__" in code:
                subprocess.run([sys.executable, file[1]], check=True, timeout=600)
            continue
        with contextlib.redirect_stdout(io.StringIO()) as out:
            exec(compile(code, f"{page.name}, {code.splitlines()[0]}", "exec"), names)  # noqa: S102 (what our own documents show)
        assert printed is None or out.getvalue().strip() == printed.strip()


def test_pieces_of_the_readme_run_each_alone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    codes = [code for code, _ in blocks(smaller(ROOT / "README.md"))]
    assert len(codes) > 3
    for place, code in enumerate(codes):
        exec(compile(code, f"README.md, piece {place}", "exec"), {"__name__": "readme"})  # noqa: S102 (what our own documents show)


def test_pieces_of_a_page_are_found():
    text = "```python\nprint(1)\n```\n\n```\n1\n```\nAnd:\n```python\nx\n```\nNo.\n\n```\ny\n```\n"
    assert list(blocks(text)) == [("print(1)\n", "1\n"), ("x\n", None)]


def methods():
    """Public filters, smoothers, schemes and kernels of chains, by name."""
    kinds = (mo.Filter, mo.smoothers.Smoother, mo.resampling.Scheme, mo.mcmc.Kernel)
    rooms = (mo, mo.smoothers, mo.resampling, mo.mcmc, mo.parameters)
    found = [getattr(room, name) for room in rooms for name in room.__all__]
    return sorted({one for one in found if inspect.isclass(one) and issubclass(one, kinds) and not inspect.isabstract(one)},
                  key=lambda one: one.__name__)  # fmt: skip


METHODS = methods()
LONG = {"ParticleGibbs", "RaoBlackwellizedParticleGibbs", "PseudoMarginal", "AdaptiveSize", "NUTS", "HMC", "GaussianFilter",
        "ReversibleJump", "MixtureSmoother", "RaoBlackwellizedSmoother"}  # fmt: skip
"""Those whose example takes long, or is that of others once more: by night, as are four of five others."""


@pytest.mark.parametrize("method", each({one.__name__: one for one in METHODS}, LONG | but_one_in([one.__name__ for one in METHODS], 5)))
def test_example_of_a_method_runs(method):
    found = doctest.DocTestParser().get_doctest(inspect.getdoc(method), {"mo": mo, "jax": jax, "jnp": jnp}, method.__name__, None, 0)
    assert 0 < len(found.examples) <= 5 and method.__name__ in found.docstring.partition("Example:")[2]
    said = []
    assert not doctest.DocTestRunner(verbose=False).run(found, out=said.append).failed, "".join(said)


def test_every_method_names_its_sources():
    """By authors, year and title, as in references.bib."""
    bib = " ".join((ROOT / "docs" / "references.bib").read_text().split())
    titles = dict(re.findall(r"title = \{(.*?)\},.*?year = \{(\d+)\}", bib))
    assert len(METHODS) > 50 and len(titles) > 100
    for method in METHODS:
        source = re.search(r"^Source: (.*?)\.$", inspect.getdoc(method), re.S | re.M)
        assert source, method.__name__
        for one in re.split(r"; (?=\D+ \d{4}, )", " ".join(source[1].split())):
            authors, year, title = re.fullmatch(r"(\D+) (\d{4}), (.*)", one).groups()
            assert titles.get(title) == year and all(name in bib for name in authors.split(", ")), one
