"""Nodes on a field: where they stand, who hears whom, and what a message costs."""

from functools import cached_property

import numpy as np

FIELD = 1000.0
"""Meters on each side."""
ROWS, COLUMNS = 3, 4
SIGHT, RADIO = 450.0, 480.0
"""Meters as far as a node sees the target, and as far as another node hears it."""
NUMBER = 4
"""Bytes of a number."""
SUMMARY = NUMBER * (4 + 10)
"""Bytes of a Gaussian of four states: a vector and half of a symmetric matrix."""
BEARING = NUMBER + 1
"""Bytes of a bearing with the number of its node."""


class Network:
    """Nodes of a sensor network.

    Attributes:
        places: of the nodes, meters, `(n, 2)`.
        linked: who hears whom, bool, `(n, n)`.
    """

    def __init__(self, seed: int = 0):
        """Put nodes near the points of a grid."""
        rng = np.random.default_rng(seed)
        grid = np.stack(np.meshgrid((np.arange(COLUMNS) + 0.5) / COLUMNS, (np.arange(ROWS) + 0.5) / ROWS), axis=-1).reshape(-1, 2)
        self.places = FIELD * grid + rng.uniform(-60, 60, grid.shape)
        apart = np.linalg.norm(self.places[:, None] - self.places, axis=-1)
        self.linked = (apart < RADIO) & ~np.eye(len(grid), dtype=bool)

    @cached_property
    def tree(self) -> tuple[np.ndarray, np.ndarray]:
        """Parents `(n,)` and hops to the root `(n,)` of the flattest tree of links; the root is its own parent."""
        hops = min((self.hops_from(node) for node in range(len(self.places))), key=np.sum)
        parents = np.array([node if hop == 0 else int(np.argmax(self.linked[node] & (hops == hop - 1))) for node, hop in enumerate(hops)])
        return parents, hops

    def hops_from(self, root: int) -> np.ndarray:
        """Return the hops of each node from one of them, `(n,)`."""
        hops = np.full(len(self.places), -1)
        hops[root] = reached = 0
        while (hops < 0).any():
            new = self.linked[hops == reached].any(axis=0) & (hops < 0)
            if not new.any():
                raise ValueError(f"nodes {np.flatnonzero(hops < 0).tolist()} hear nobody of the others")
            reached += 1
            hops[new] = reached
        return hops

    @cached_property
    def averaging(self) -> np.ndarray:
        """Weights `(n, n)` with which a node averages its own and its neighbors' numbers in a round (Xiao, Boyd, Lall 2005)."""
        degree = self.linked.sum(axis=1)
        weights = np.where(self.linked, 1 / (1 + np.maximum(degree[:, None], degree)), 0.0)
        return weights + np.diag(1 - weights.sum(axis=1))

    def bytes_of_summaries(self) -> int:
        """Bytes sent so that all nodes know a sum: up the tree, in which each adds its own, and down again."""
        return 2 * (len(self.places) - 1) * SUMMARY

    def bytes_of_consensus(self, rounds: int) -> int:
        """Bytes sent in so many rounds, in which each node sends to each that hears it."""
        return rounds * int(self.linked.sum()) * SUMMARY

    def bytes_of_bearings(self, seen: np.ndarray) -> tuple[float, float]:
        """Mean bytes a step so that the root knows all bearings, and so that all nodes do; `seen` `(..., n)` says who has one."""
        count = seen.reshape(-1, len(self.places)).mean(axis=0)
        return BEARING * float(count @ self.tree[1]), BEARING * float(count.sum()) * (len(self.places) - 1)
