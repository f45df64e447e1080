"""Results of a study that never ran."""

import numpy as np

import motes as mo

RUNS, STEPS = 9, 5


def made_result(filters=("ref", "other")):
    """Skewed errors of three states, two blocks; run 4 of the second filter has gone far away."""
    draw = np.random.default_rng(5)
    truth = draw.standard_normal((RUNS, STEPS, 3))
    errors = draw.gamma(1.5, [0.5, 1.0, 2.0], (2, RUNS, STEPS, 3)) - 0.3
    errors[1, 4] += 100.0
    nees = draw.gamma(1.0, 2.0, (2, RUNS, STEPS, 2))
    return mo.studies.StudyResult(
        truth=truth, estimates=truth + errors, nees=nees, ess=np.ones((2, RUNS)), log_likelihood=np.zeros((2, RUNS)),
        collapsed=np.full((2, RUNS), -1), filters=filters, labels=("A", "B"), gives_up=(True, True), states=("x", "y", "z"), angles=(),
        blocks=(("plane", ("z", "x")), ("y", ("y",))), lost_beyond=None, seed=0, provenance=(("jax_version", "1"),))
