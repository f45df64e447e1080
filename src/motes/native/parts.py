"""Long programs in parts: compilers take much more than twice as long over a loop that is twice as long.

Each part is a loop over the particles of a block; what a later part needs is kept in arrays.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

MOST = 300
"""Statements of a part."""

WORDS = re.compile(r"\w+")


class Parts(NamedTuple):
    """Statements by part.

    Attributes:
        bodies: statements of each part.
        kept: C++ that declares the arrays through which parts hand on what they know.
        lanes: how many particles are worked on by one part after the other, so that these arrays stay in the cache.
    """

    bodies: list[list[str]]
    kept: list[str]
    lanes: str


def needed(statements: Sequence[str], ends: Sequence[str]) -> list[str]:
    """Return the statements, each of which gives a name to an expression, that some last ones need; compilers find them too, but slowly."""
    words = {word for end in ends for word in WORDS.findall(end)}
    kept = []
    for statement in reversed(statements):
        _, _, name, *used = WORDS.findall(statement)
        if name in words:
            words.update(used)
            kept.append(statement)
    return kept[::-1]


def in_parts(statements: Sequence[str], ends: Sequence[str]) -> Parts:
    """Divide the statements that some last ones need, each of which gives a name to an expression, each put as late as it can be."""
    ordered = _ordered(statements, ends)
    text_of = {WORDS.findall(statement)[2]: statement for statement in ordered if statement.startswith("const ")}
    made: list[list[str]] = []
    later: list[str] = []
    known: set[str] = set()

    def from_before(name: str, body: list[str], there: set[str]) -> None:
        """Have a part know what an earlier one worked out; truths are worked out, and numbers taken in, again."""
        if name not in known or name in there:
            return
        there.add(name)
        _, kind, _, *used = WORDS.findall(text_of[name])
        if kind == "bool" or (name.startswith("x") and "ancestors" not in used):
            for word in used:
                from_before(word, body, there)
            body.append(text_of[name])
            return
        body.append(f"const {kind} {name} = kept.{name}[i];")
        later.append(name)

    for first in range(0, len(ordered), MOST):
        statements = ordered[first : first + MOST]
        body: list[str] = []
        there: set[str] = set()
        for statement in statements:
            for word in WORDS.findall(statement):
                from_before(word, body, there)
        made.append(body + statements)
        known.update(WORDS.findall(statement)[2] for statement in statements if statement.startswith("const "))
    later = list(dict.fromkeys(later))
    for k, body in enumerate(made):
        own = {WORDS.findall(statement)[2] for statement in ordered[k * MOST : (k + 1) * MOST] if statement.startswith("const ")}
        body += [f"kept.{name}[i] = {name};" for name in later if name in own]
    kinds = {name: WORDS.findall(text_of[name])[1] for name in later}
    lanes = "BLOCK" if len(made) == 1 else "PIECE"
    return Parts(made, [f"alignas(64) {kinds[name]} {name}[PIECE];" for name in later], lanes)


def _ordered(statements: Sequence[str], ends: Sequence[str]) -> list[str]:
    """Put every statement just before the first one that needs it, so that parts have little to hand on."""
    text_of = {WORDS.findall(statement)[2]: statement for statement in statements}
    there: set[str] = set()
    ordered: list[str] = []
    for end in ends:
        waiting = [("", end)]
        while waiting:
            name, text = waiting[-1]
            missing = [word for word in dict.fromkeys(WORDS.findall(text)) if word != name and word in text_of and word not in there]
            if missing:
                waiting += [(word, text_of[word]) for word in reversed(missing)]
                continue
            waiting.pop()
            if name not in there:
                ordered.append(text)
                there.add(name or text)
    return ordered
