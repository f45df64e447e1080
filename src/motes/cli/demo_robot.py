"""`motes demo robot`: locate a robot by its ranges to four surveyed beacons.

Without `--data` the recording is made up. A real one is Plaza1 of the five range-only data sets of Djugash, Hamner and Roth (Journal of
Field Robotics, 2009), a MATLAB file that is not part of the package; it comes with gtsam, in gtsam/Data. Writes to the folder `--out`: the
NetCDF history, `summary.json`, `robot.png`, `states.png`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from motes.cli.compiled import keep_programs
from motes.cli.filters import FilterChoice, build
from motes.cli.options import check_seed, from_flags


@dataclass(frozen=True)
class Demo:
    """Locate a robot by ranges to four beacons.

    Attributes:
        data: a recording, a file such as Plaza1_.mat; a made-up one if not given.
        odometry: "recorded" as in the file, or "drifting": turns from the drifting path, 20 m off on their own.
        outliers: share of ranges that may be far off, such as 0.1; 0 for Gaussian errors.
        start: "known", or "unknown": sought by the first ranges, and scored two minutes later; take 5 000 particles.
        n: number of particles.
        linear: states that a Kalman filter carries.
        seed: of the filter.
        out: folder for the results.
    """

    data: str = field(default="", metadata={"path": True})
    odometry: Literal["recorded", "drifting"] = "recorded"
    outliers: float = 0.0
    start: Literal["known", "unknown"] = "known"
    n: int = 1_000
    linear: tuple[str, ...] = ("scale", "offset")
    seed: int = 0
    out: str = field(default="out", metadata={"path": True})


def main(words: Sequence[str]) -> None:
    """Run the demonstration.

    Raises:
        MotesError: an option cannot be used, or a file cannot be read or written.
    """
    settings = from_flags(Demo(), words, "motes demo robot")
    check_seed(settings.seed)
    keep_programs()
    import jax

    from motes.applications.range_only import scenario as job
    from motes.applications.range_only.world import simulated
    from motes.cli import running
    from motes.core import checks
    from motes.io.recordings import read_plaza
    from motes.plotting.plot import plot
    from motes.plotting.robot import robot_figure

    for module in ("matplotlib.figure", "xarray", "h5netcdf"):
        checks.need(module, "results")
    running.check_folder(settings.out)
    recording = read_plaza(settings.data) if settings.data else simulated(settings.seed)
    scenario = job.of_recording(recording, settings.odometry, settings.outliers, settings.start)
    chosen = build(FilterChoice(n=settings.n, linear=settings.linear))
    ys = jax.numpy.asarray(scenario.ys)
    outcome = running.race(settings.seed, {"marginalized": chosen}, scenario.model, ys, scenario.inputs)["marginalized"]
    score = job.score(outcome.history, scenario)
    alone = float(((scenario.dead_reckoning - scenario.truth[:, :2]) ** 2).sum(axis=1).mean() ** 0.5)
    found = running.results(outcome) | {f"{name}_m": float(getattr(score, name)) for name in ("rms", "worst", "final")}
    found |= {"scale": float(score.scale), "scale_sd": float(score.scale_sd), "odometry_alone_rms_m": alone}
    row = (
        "marginalized", str(settings.n), running.number(found["rms_m"], 2), running.number(found["worst_m"], 2),
        running.number(found["scale"], 4), running.number(found["median_ess"], 0),
        running.number(found["milliseconds_per_step"], 2),
    )
    head = ("filter", "n", "RMS, m", "worst, m", "scale", "ESS", "ms/step")
    title = f"{scenario.ys.shape[0]} steps over {scenario.times[-1]:.0f} s; position errors (by odometry alone {alone:.2f} m)"
    running.show(title, head, [row])
    folder = running.made_folder(settings.out)
    outcome.history.save(folder / "robot.nc")
    running.write_figure(folder / "robot.png", robot_figure(outcome.history, scenario))
    running.write_figure(folder / "states.png", plot(outcome.history))
    running.write_summary(folder / "summary.json", settings, found)
    print(job.diagnosed(outcome.history, scenario))
    print(f"Results are in {folder}.")
