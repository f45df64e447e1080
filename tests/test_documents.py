"""Names, files and sources that the documents speak of exist."""

import inspect
import re
import runpy
from pathlib import Path

import pytest

import motes as mo

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md")),
             *sorted((ROOT / "examples").rglob("*.md")), *sorted((ROOT / "papers").rglob("*.md"))]  # fmt: skip


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


def test_tests_named_in_documents_exist():
    named = {found for document in DOCUMENTS for found in re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", document.read_text())}
    assert len(named) >= 15
    for file, test in named:
        assert f"\ndef {test}(" in (ROOT / file).read_text(), f"{file}::{test}"


def test_fifteen_habits_have_a_test_each():
    rows = [line for line in (ROOT / "docs" / "habits.md").read_text().splitlines() if "`tests/" in line]
    assert len(rows) == 15


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


def uncited(text, entries):
    """Sources `Author, Author 1999` of a text that no entry (surnames, year) has."""
    surname = r"(?:(?:Del|Van|van der|van|von|de) )?[A-Z][\w\-]+"
    cited = re.findall(rf"({surname}(?:(?:, | and ){surname})*)(?: et al\.)?(?: [IV]+)?,? \(?((?:19|20)\d\d)\b", text)
    return {f"{names} {year}" for names, year in cited
            if not any(year == when and plain(re.split(", | and ", names)[-1]) in authors for authors, when in entries)}  # fmt: skip


def plain(name):
    return name.replace("ö", "o").replace("ä", "a").replace("í", "i").replace("á", "a")


def test_sources_are_among_the_references():
    """Words before a year that are no authors are left out."""
    bib = (ROOT / "docs" / "references.bib").read_text()
    known = re.findall(r"author = \{(.*?)\},.*?year = \{(\d+)\}", bib, re.S)
    entries = [({name.split(",")[0] for name in authors.split(" and ")}, year) for authors, year in known]
    assert len(entries) > 100 and uncited("(Gordon, Salmond, Smyth 1993)", entries) and uncited("Green 1996", entries)
    texts = [path.read_text() for path in [*(ROOT / "src").rglob("*.py"), *(ROOT / "docs").rglob("*.md")]]
    missing = {found for text in texts for found in uncited(text, entries)}
    assert {one for one in missing if not re.match(r"GRS|CGCS|SeedSequence|Robotics", one)} == set()
