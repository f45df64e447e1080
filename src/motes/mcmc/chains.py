"""The record of chains."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, markdown
from motes.core.findings import Diagnosis
from motes.core.record import record, static
from motes.io import archive
from motes.io.result_table import Table
from motes.mcmc import judgement
from motes.mcmc.interface import Info, Kernel, LogDensity, State


@record
class Chains:
    """What `mo.sample` gives.

    Attributes:
        positions: tree of arrays with the axes chain and draw first.
        log_density: of each, `(chain, draw)`.
        info: what the moves did while these draws were made, each `(chain, move)`.
        last: what is needed to continue, chain axis first.
        steps: made so far, burn-in included.
        moves: names of the kernel's moves.
        label: the kernel, as it prints.
    """

    positions: Any
    log_density: jax.Array
    info: Info
    last: State
    steps: jax.Array
    moves: tuple[str, ...] = static()
    label: str = static()

    @property
    def acceptance(self) -> dict[str, float]:
        """Share of accepted proposals of each move, over all chains; NaN for moves that were never tried."""
        tried, accepted = (np.asarray(part, np.float64).sum(axis=0) for part in (self.info.tried, self.info.accepted))
        return dict(zip(self.moves, np.divide(accepted, tried, out=np.full_like(tried, np.nan), where=tried > 0).tolist(), strict=True))

    def columns(self) -> dict[str, np.ndarray]:
        """Return the draws `(chain, draw)` of each number of the position, by name."""
        found = {}
        for name, values in self._named().items():
            for index in np.ndindex(values.shape[2:]):
                found[name + (f"[{','.join(map(str, index))}]" if index else "")] = values[(slice(None), slice(None), *index)]
        return found

    def _named(self) -> dict[str, np.ndarray]:
        """Return the arrays of the position by name, `x` where there is but one without a name."""
        leaves = jax.tree_util.tree_flatten_with_path(self.positions)[0]
        return {"_".join(archive.path_names(path)) or "x": np.asarray(leaf) for path, leaf in leaves}

    def summary(self) -> Table:
        """Return a table of mean, standard deviation, quantiles, standard error, effective sizes and R-hat of each number."""
        return judgement.summary(self.columns())

    def diagnose(self) -> Diagnosis:
        """Say in words whether to trust the chains: see `mcmc.judgement`."""
        return judgement.diagnosis_of(self)

    def __str__(self) -> str:
        """Print the summary, the acceptance of each move and the verdict."""
        return f"{self.summary()}\naccepted: {', '.join(map(' '.join, self._rates()))}\n{self.diagnose()}"

    def _repr_markdown_(self) -> str:
        accepted = markdown.table(("move", "accepted"), self._rates())
        return "\n".join([self.summary().to_markdown(), accepted, self.diagnose()._repr_markdown_()])

    def _rates(self) -> list[tuple[str, str]]:
        return [(move, "-" if np.isnan(rate) else f"{rate:.0%}") for move, rate in self.acceptance.items()]

    def to_datatree(self) -> Any:
        """Return an `xarray.DataTree` as ArviZ wants it (extra `results`): groups posterior and sample_stats."""
        groups = {"posterior": self._named(), "sample_stats": {"lp": np.asarray(self.log_density)}}
        return checks.need("arviz_base", "results").from_dict(groups, attrs={"/": archive.provenance() | {"kernel": self.label}})

    def save(self, path: str | Path) -> Path:
        """Write to a `.npz` file all that is needed to look at the chains and to continue them.

        Raises:
            FileError: the ending is another, or the file cannot be written.
        """
        path = archive.npz_path(path)
        tree = {"positions": self.positions, "log_density": self.log_density, "info": self.info, "last": self.last, "steps": self.steps}
        return archive.write_tree(path, tree, {"moves": list(self.moves), "kernel": self.label}, kind="chains")

    @classmethod
    def load(cls, path: str | Path, kernel: Kernel | None = None, log_density: LogDensity | None = None, position: Any = None) -> "Chains":
        """Read chains back.

        Args:
            path: of the file.
            kernel: with which they were made; needed, as the next two are, to continue them.
            log_density: likewise.
            position: any, for its form; without it positions come back as an array or nested dictionaries of arrays.

        Raises:
            FileError: the file holds no chains, is damaged, or does not fit the arguments.
        """
        path = Path(path)
        tree, texts = archive.read_tree(path, "chains", lambda forms, texts: _check_forms(path, forms, texts))
        if not np.isfinite(tree["log_density"]).all():
            checks.refuse(f"{path}: log_density", "finite numbers", "NaN or infinite ones", "Restore it from a copy.", checks.FileError)
        counts = {name: jnp.asarray(tree["info"][name]) for name in ("tried", "accepted", "invalid")}
        positions, last = tree["positions"], tree["last"]
        if kernel is not None and log_density is not None:
            shape = tree["log_density"].shape
            position = jax.tree.map(lambda leaf: leaf[0, 0], positions) if position is None else position
            position = jax.tree.map(jnp.asarray, position)
            kernel.check(jax.random.key(0), log_density, position)
            one = jax.eval_shape(lambda position: kernel.init(jax.random.key(0), log_density, position), position)
            like = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((shape[0], *leaf.shape), leaf.dtype), one)
            last = archive.fill(path, {"last": like}, tree)["last"]
            every = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((*shape, *leaf.shape), leaf.dtype), position)
            positions = archive.fill(path, {"positions": every}, tree)["positions"]
        return cls(positions, jnp.asarray(tree["log_density"]), Info(**counts), last, tree["steps"], tuple(texts["moves"]), texts["kernel"])


def _check_forms(path: Path, forms: dict[str, Any], texts: dict[str, Any]) -> None:
    """Refuse a file whose arrays cannot be those of chains, before they are read."""
    moves = texts.get("moves")
    if not isinstance(moves, list) or not all(isinstance(move, str) for move in moves) or not isinstance(texts.get("kernel"), str):
        checks.refuse(f"{path}: texts", "names of moves and of a kernel", "others", "Restore it from a copy.", checks.FileError)
    archive.agree(path, forms, {"log_density": ((None, None), "f"), "steps": ((), "iu")})
    chains, draws = forms["log_density"].shape
    counts = {"tried": "iuf", "accepted": "iuf", "invalid": "iu"}
    archive.agree(path, forms, {f"info/{name}": ((chains, len(moves)), kind) for name, kind in counts.items()})
    archive.agree(path, forms, {"last/log_density": ((chains,), "f")})
    archive.repeats(path, forms, "positions", (chains, draws), "last/position", (chains,))


def joined(pieces: list[Chains]) -> Chains:
    """Put consecutive draws of the same chains together."""
    if not pieces:
        checks.refuse("pieces", "at least one Chains", "none")
    if len({(piece.log_density.shape[0], piece.moves) for piece in pieces}) > 1:
        checks.refuse("pieces", "chains of one number and one kernel", f"{[piece.log_density.shape[0] for piece in pieces]} chains")
    drawn = [(piece.positions, piece.log_density) for piece in pieces]
    positions, log_density = jax.tree.map(lambda *leaves: jnp.concatenate(leaves, axis=1), *drawn)
    info = jax.tree.map(lambda *leaves: sum(leaves[1:], leaves[0]), *[piece.info for piece in pieces])
    final = pieces[-1]
    return Chains(positions, log_density, info, final.last, final.steps, final.moves, final.label)
