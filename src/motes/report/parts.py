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


def filled(page: str, scripts: Sequence[str], styles: Sequence[str], *, title: str, data: Any, images: bool = False, **texts: str) -> str:
    """Return a page: `frame.html` around a template of this folder, with styles, and scripts that its policy knows by digest.

    Args:
        page: name of the template, and of its own styles, without ending.
        scripts: names of files.
        styles: names of files that come before the page's own.
        title: heading.
        data: what the scripts read, for JSON.
        images: whether it holds pictures.
        texts: what else the template holds, safe to stand where it stands.
    """
    folder = files("motes.report")

    def read(name: str) -> str:
        return folder.joinpath(*name.split("/")).read_text("utf-8").strip()

    contents = [read(name) for name in scripts]
    digests = [base64.b64encode(hashlib.sha256(content.encode()).digest()).decode() for content in contents]
    return Template(read("frame.html") + "\n").substitute(
        title=escape(title), data=_in_json(data), images="img-src data:; " if images else "",
        hashes=" ".join(f"'sha256-{digest}'" for digest in digests), styles="\n".join(map(read, (*styles, f"{page}.css"))),
        body=Template(read(f"{page}.html")).substitute(texts), scripts="\n".join(f"<script>{content}</script>" for content in contents),
    )  # fmt: skip


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


def _in_json(value: Any) -> str:
    """Return JSON that may stand inside a script element: nothing in it can end the element or open another."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False).translate(_UNSAFE)
