"""Tables in Markdown, which notebooks show as tables."""

from collections.abc import Sequence


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[bool] = ()) -> str:
    """Return a table.

    Args:
        columns: names.
        rows: texts.
        right: whether each column stands on the right; none does when not given.
    """
    rule = ["---:" if side else "---" for side in right or [False] * len(columns)]
    lines = [[escaped(text) for text in columns], rule, *([escaped(text) for text in row] for row in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def escaped(text: str) -> str:
    """Return a text that shows as it is."""
    return "".join("&lt;" if c == "<" else "&amp;" if c == "&" else f"\\{c}" if c in r"\`*_{}[]|~" else c for c in text)
