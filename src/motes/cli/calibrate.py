"""`motes calibrate`: the constants of this machine beside the paper's."""

from collections.abc import Sequence
from dataclasses import dataclass

from motes.cli.options import from_flags

MEANINGS = {"c1": "a likelihood", "c2": "a resampling", "c3": "a normal number"}


@dataclass(frozen=True)
class Calibrate:
    """Measure what a flop, a likelihood, resampling and a normal number cost here, for the paper's radar model.

    Attributes:
        refresh: measure again even if there is an earlier result.
    """

    refresh: bool = False


def main(words: Sequence[str]) -> None:
    """Print the table.

    Raises:
        MotesError: an option cannot be used, or the machine was too busy.
    """
    settings = from_flags(Calibrate(), words, "motes calibrate")
    from motes.cli.running import show
    from motes.costs.calibration import calibrate
    from motes.costs.flops import Costs

    found = calibrate(refresh=settings.refresh)
    paper = Costs.paper()
    rows = [(f"{name}, {MEANINGS[name]}", f"{slope.value:.1f}", f"{slope.low:.1f} to {slope.high:.1f}", f"{slope.r_squared:.3f}",
             f"{getattr(paper, name):.0f}") for name, slope in found.equivalent_flops.items()]
    show(f"equivalent flops on {found.device}, engine {found.engine}", ("operation", "here", "95% interval", "R squared", "paper"), rows)
    print(f"one flop takes {1e9 * found.flop.value:.3f} ns ({1e9 * found.flop.low:.3f} to {1e9 * found.flop.high:.3f} ns).")
