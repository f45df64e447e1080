"""Writes a table of results as a page beside this file, under the words that its script says of itself."""

from pathlib import Path

from motes.io.archive import provenance


def write_page(name, title, words, table):
    """Print a table and write it as name.md, with a title, words and versions above it."""
    print(table)
    facts = ", ".join(f"{key.removeprefix('motes_')} {value}" for key, value in provenance().items())
    place = Path(__file__).parent / f"{name}.md"
    table.save(place)
    place.write_text(f"# {title}\n\n{words}\n\n{facts}\n\n{place.read_text()}")


def told(document):
    """Return what the head of a script says below its command."""
    return document.split("\n\n")[2].strip()
