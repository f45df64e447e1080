"""The README's example runs as it stands and prints what it says; names in the documents exist."""

import inspect
import re
import runpy
from pathlib import Path

import pytest

import motes as mo

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md")),
             *sorted((ROOT / "examples").rglob("*.md"))]  # fmt: skip


def test_readme_example(tmp_path, capsys):
    code, *_ = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    script = tmp_path / "example.py"
    script.write_text(code)
    names = runpy.run_path(str(script))
    assert names["history"].mean.shape == (100, 6)
    printed = capsys.readouterr().out.strip()
    assert printed in (ROOT / "README.md").read_text()


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_public_names_exist(document):
    for name, inner in set(re.findall(r"\bmo\.([A-Za-z_]+)(?:\.([A-Za-z_]+))?", document.read_text())):
        assert hasattr(mo, name), name
        if inspect.ismodule(getattr(mo, name)) and inner:
            assert hasattr(getattr(mo, name), inner), f"{name}.{inner}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_files_named_in_documents_exist(document):
    for link in re.findall(r"\]\(([^)#]+)\)", document.read_text()):
        if "://" not in link:
            assert (document.parent / link).exists(), link


def test_pages_are_what_the_methods_say_of_themselves():
    pages = runpy.run_path(str(ROOT / "docs" / "pages.py"))["pages"]()
    assert len(pages) > 20
    for path, text in pages.items():
        assert path.read_text() == text, f"{path.name}: run python docs/pages.py"


def test_every_public_name_is_documented():
    prose = "".join(document.read_text() for document in DOCUMENTS)
    rooms = [mo, *(room for room in (getattr(mo, name) for name in mo.__all__) if inspect.ismodule(room) and hasattr(room, "__all__"))]
    assert len(rooms) > 10
    for room in rooms:
        for name in room.__all__:
            assert getattr(getattr(room, name), "__doc__", None), name
            assert re.search(rf"\b{name}\b", prose), f"{name}: not in README.md or docs/"
