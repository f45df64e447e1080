"""One file per engine, ours too: `prepare(task, **options)` returns `job(seed) -> log likelihood`, which returns when the work is done.

A task is a dictionary: kind ("bootstrap", "many", "marginalized", "kalman", "block"), model, n, ys and what the kind needs besides.
"""


class Unavailable(Exception):
    """An engine does not offer a task; the text says why and stands in the results."""


def offers(task, kinds):
    """Refuse a task of another kind.

    Raises:
        Unavailable: the kind is not among those.
    """
    if task["kind"] not in kinds:
        raise Unavailable("does not offer this")
