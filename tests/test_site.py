"""The site is built without a warning, loads nothing from elsewhere, and has a page for every public name."""

import inspect
import os
import re
import subprocess
import sys
from importlib.util import find_spec

import pytest

import motes as mo
from test_documents import ROOT

TEXTS = {path: path.read_text() for path in sorted((ROOT / "docs" / "contents").glob("*.md"))}


def test_every_document_is_in_the_table_of_contents():
    """But for those that a pattern there takes up."""
    lines = [(path, line) for path, text in TEXTS.items() for line in text.splitlines() if line.startswith("../")]
    listed = {(path.parent / f"{line}.md").resolve() for path, line in lines}
    for document in sorted((ROOT / "docs").glob("*.md")):
        assert any(document.resolve().match(str(one)) for one in listed), f"{document.name}: not in docs/contents"


@pytest.mark.night
@pytest.mark.skipif(not (find_spec("sphinx") and find_spec("myst_nb")), reason="the extra docs is not installed")
def test_the_site_is_built_without_a_warning(tmp_path):
    words = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", "-c", "docs", "-d", str(tmp_path / "trees"), "."]
    surroundings = os.environ | {"MOTES_NIGHTLY": ""}  # notebooks of the examples are run by make docs, in half an hour
    done = subprocess.run([*words, str(tmp_path / "site")], cwd=ROOT, env=surroundings, capture_output=True, text=True, timeout=1200)
    assert done.returncode == 0, done.stderr[-2000:]
    pages = {path: path.read_text() for path in (tmp_path / "site").rglob("*.html")}
    assert len(pages) > 300 and (tmp_path / "site" / "searchindex.js").is_file()
    for path, text in pages.items():
        assert not re.search(r"<(?:script|link|img)[^>]*(?:src|href)=\"https?:", text), path
        assert '<link rel="icon" href="data:,">' in text, path  # browsers would ask for one that is not there
    for name in mo.__all__:
        if not inspect.ismodule(getattr(mo, name)):
            assert (tmp_path / "site" / "docs" / "api" / f"motes.{name}.html").is_file(), name
