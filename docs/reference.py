"""Pages of every public name for the site: which there are, and docstrings, prose with single backticks, as Sphinx wants them."""

import inspect
import re
from pathlib import Path

import motes as mo

HEAD = """Every public name
=================

"""
TABLE = """{title}
{line}

.. autosummary::
   :toctree: .

{names}

"""


def rooms():
    """Return public names by the namespace that they are reached by."""
    found = {"motes": []}
    for name in mo.__all__:
        value = getattr(mo, name)
        if inspect.ismodule(value):
            own = getattr(value, "__all__", None) or [one for one, what in vars(value).items() if _is_own(value, one, what)]
            found[value.__name__] = sorted(own)
        else:
            found["motes"].append(name)
    return found


def _is_own(room, name, value):
    return not name.startswith("_") and callable(value) and getattr(value, "__module__", "") == room.__name__


def write(folder: Path) -> None:
    """Write the list of all names, from which a page for each is made."""
    folder.mkdir(exist_ok=True)
    pages = [HEAD]
    for room, names in rooms().items():
        title = f"``{room.replace('motes', 'mo', 1)}``"
        pages.append(TABLE.format(title=title, line="-" * len(title), names="\n".join(f"   {room}.{name}" for name in names)))
    text = "".join(pages)
    if not (folder / "index.rst").exists() or (folder / "index.rst").read_text() != text:
        (folder / "index.rst").write_text(text)


def escaped(app, what, name, obj, options, lines):
    """Keep what stands outside of backticks from being read as markup."""
    example = False
    for place, line in enumerate(lines):
        if line.strip() in ("Example:", "Examples:"):
            example = True
        elif line and not line.startswith(" "):
            example = False
        if not example:
            # a letter right after a backtick ("`Law`s") would not end the code
            parts = re.split(r"(`[^`]*`)", re.sub(r"(`[^`]*`)(?=\w)", r"\1\\ ", line))
            lines[place] = "".join(part if part.startswith("`") else re.sub(r"[*|]|_(?=\W|$)", r"\\\g<0>", part) for part in parts)
