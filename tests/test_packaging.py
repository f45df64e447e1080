"""What a package index shows and what extras bring."""

import re
import subprocess
import sys
import tomllib

import pytest

from sources import SOURCE
from test_documents import ROOT
from test_shown_code import blocks

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
EXTRAS = PROJECT["project"]["optional-dependencies"]
MODULES = {"arviz-base": "arviz_base", "arviz-stats": "arviz_stats", "pyzmq": "zmq"}
"""Packages whose module has another name than dots and dashes tell."""
WITH = {"PIL": "matplotlib"}
"""Modules that come with another package."""
LIVE = {"starlette", "uvicorn", "websockets", "zmq"}
"""Of the live page and of live sources."""
TEXT = "\n".join(path.read_text() for path in sorted(SOURCE.rglob("*.py")))
NEEDED = set(re.findall(r"need\(\"(\w+)[\w.]*\", \"(\w+)\"\)", TEXT))


def brought(extra):
    """Modules of the packages of an extra."""
    names = [re.match(r"[\w-]+", one)[0] for one in EXTRAS[extra]]
    return {MODULES.get(name, name) for name in names}


def test_each_refusal_names_an_extra_that_brings_the_module():
    assert len(NEEDED) > 10
    for module, extra in NEEDED:
        assert WITH.get(module, module) in brought(extra), (module, extra)


@pytest.mark.parametrize("extra", sorted(set(EXTRAS) - {"all", "test", "dev", "docs"}))
def test_extras_bring_what_is_used_and_nothing_else(extra):
    used = {WITH.get(module, module) for module, _ in NEEDED} | set(re.findall(r"find_spec\(\"(\w+)\"\)", TEXT)) | LIVE
    # of arrays in files: h5netcdf is the name of an engine, and brings no h5py
    assert brought(extra) <= used | {"h5py"}


def test_all_is_every_extra_of_users():
    assert set(re.findall(r"\w+", EXTRAS["all"][0])) - {"motes"} == set(EXTRAS) - {"all", "test", "dev", "docs", "native"}


def test_no_link_of_the_readme_leads_nowhere_on_a_package_index():
    hook = PROJECT["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]
    text = (ROOT / "README.md").read_text()
    for change in hook["substitutions"]:
        text = re.sub(change["pattern"], change["replacement"], text)
    links = re.findall(r"\]\(([^)]*)\)", text)
    assert links and all(link.startswith("https://") for link in links)
    assert "how to choose" in text and text.count("```") == (ROOT / "README.md").read_text().count("```")


def test_the_core_alone_runs_the_first_lines_and_names_what_is_missing(tmp_path):
    """In an interpreter in which no package of any extra can be imported."""
    first, _ = next(blocks((ROOT / "README.md").read_text()))
    gone = sorted(set().union(*map(brought, set(EXTRAS) - {"all", "test", "dev", "docs"})) | {"PIL", "pandas"})
    program = f"""
import sys
for name in {gone}:
    sys.modules[name] = None
{first}
calls = {{
    "results": lambda: mo.plot(history), "results ": lambda: history.to_xarray(), "results  ": lambda: history.save("x.nc"),
    "mcmc": lambda: mo.sample(0, mo.mcmc.NUTS(0.1), lambda x: -x @ x, jnp.zeros(1), draws=2),
    "terrain": lambda: mo.io.read_raster("x.tif"), "io": lambda: mo.io.read_table("x.parquet"),
}}
open("x.tif", "wb").write(b"II*" + bytes(200)), open("x.parquet", "wb").write(b"PAR1" + bytes(20) + b"PAR1")
for extra, call in calls.items():
    try:
        call()
    except mo.MissingExtraError as error:
        assert f"pip install 'motes[{{extra.strip()}}]'" in str(error), (extra, error)
    else:
        raise AssertionError(extra)
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120, cwd=tmp_path)
