"""What all pages share: a template filled, scripts that the page knows by digest, tables, and data that cannot come alive."""

import base64
import hashlib
import json
import math
import platform
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from string import Template
from typing import Any

_UNSAFE = {ord(c): f"\\u{ord(c):04x}" for c in "<>&\u2028\u2029"}


def filled(template: str, scripts: Sequence[str], styles: Sequence[str], **texts: str) -> str:
    """Return a page: a template of this folder with its scripts, each under its name up to the first point, their digests, and styles.

    Args:
        template: name of the file.
        scripts: names of files.
        styles: names of files, put together.
        texts: what else it holds, safe to stand where it stands.
    """
    folder = files("motes.report")
    read = {name: folder.joinpath(*name.split("/")).read_text("utf-8").strip() for name in (*scripts, *styles)}
    hashes = " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(read[name].encode()).digest()).decode()}'" for name in scripts)
    named = {name.rpartition("/")[2].partition(".")[0].lower(): read[name] for name in scripts}
    style = "\n".join(read[name] for name in styles)
    return Template((folder / template).read_text("utf-8")).substitute(texts, hashes=hashes, styles=style, **named)


def html_table(head: Any, rows: Any, texts: int) -> str:
    """Return an HTML table whose first columns are texts."""
    kinds = ["text"] * texts + [""] * (len(head) - texts)
    top = "".join(f'<th class="{kind}">{escape(name)}</th>' for kind, name in zip(kinds, head, strict=True))
    body = "".join(
        "<tr>" + "".join(f'<td class="{kind}{" long" if len(cell) > 60 else ""}">{escape(cell)}</td>'
                         for kind, cell in zip(kinds, row, strict=True)) + "</tr>\n" for row in rows)
    return f"<table><thead><tr>{top}</tr></thead><tbody>\n{body}</tbody></table>"


def origin_table(provenance: Mapping[str, str], **more: str) -> str:
    """Return the HTML table of where a result comes from, and on which system its page was made."""
    facts = {**more, "system": f"{platform.system()} {platform.machine()}", **provenance}
    return html_table(("", ""), [(name.replace("_", " "), text) for name, text in facts.items()], 2)


def rounded(value: Any, digits: int = 9) -> float | None:
    """Return a number for JSON, which has no infinite ones."""
    value = float(value)
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None


def in_json(value: Any) -> str:
    """Return JSON that may stand inside a script element: nothing in it can end the element or open another."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False).translate(_UNSAFE)
