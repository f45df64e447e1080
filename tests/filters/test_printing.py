"""What results print: a few lines that read, arrays in short form, and the same in a notebook."""

import jax
import numpy as np
import pytest

import motes as mo

STEADY = mo.StateSpaceModel(
    mo.Gaussian([0.0, 0.0], np.eye(2)),
    mo.LinearGaussian([[1.0, 1.0], [0.0, 1.0]], 0.1 * np.eye(2)),
    mo.LinearGaussian([[1.0, 0.0]], [[0.5]]),
    ("px", "vx"),
)
YS = np.linspace(0.0, 3.0, 40)[:, None]


@pytest.fixture(scope="module")
def histories():
    return {
        "kalman": mo.run(0, mo.KalmanFilter(), STEADY, YS),
        "particles": mo.run(0, mo.ParticleFilter(n=500), STEADY, YS, keep=mo.keep.laws),
    }


def test_histories_print_in_a_few_lines(histories):
    printed = {name: str(history) for name, history in histories.items()}
    assert all(len(text.splitlines()) <= 6 and "0 to 39" in text and "log likelihood" in text for text in printed.values())
    assert "effective size" in printed["particles"] and "effective size" not in printed["kalman"]
    mean, deviation = float(histories["kalman"].mean[-1, 1]), float(histories["kalman"].cov[-1, 1, 1]) ** 0.5
    assert f"vx {mean:.4g} +- {deviation:.2g}" in printed["kalman"]


def test_arrays_are_short_wherever_they_lie(histories):
    for history in histories.values():
        text = repr(history)
        assert len(text) < 2500 and "float32[40,2]" in text
    assert repr(mo.ParticleFilter(n=3)) == repr(mo.ParticleFilter(n=3)) and "..." not in repr(STEADY)


def test_what_prints_shows_in_a_notebook_too(histories):
    """As tables where they are tables, and as a block of text otherwise."""
    pilot = mo.planning.Plan(mo.KalmanFilter(), 1e-3, mo.io.Table(("filter", "ms"), (("a|b", 1.0),)), 2e-3)
    chains = mo.sample(0, mo.mcmc.RandomWalkMetropolis(1.0), lambda x: -0.5 * x @ x, np.zeros(1), draws=20, burn_in=0)
    shown = {
        "log likelihood": histories["particles"], "what to try": mo.diagnostics.Diagnosis((mo.diagnostics.Finding("a", "b", "c", True),)),
        "Kalman": mo.structure(STEADY), r"a\|b": pilot, "accepted": chains,
    }  # fmt: skip
    for words, one in shown.items():
        lines = [line for line in one._repr_markdown_().splitlines() if line.startswith("|")]
        assert words in one._repr_markdown_() and len({line.replace(r"\|", "").count("|") for line in lines[:3]}) == 1, words
    explained = mo.explain(mo.KalmanFilter(), STEADY)
    assert f"\n{explained}\n" in explained._repr_markdown_()
    assert "px, vx" in STEADY._repr_markdown_() and "needs" in mo.ParticleFilter(n=3)._repr_markdown_()


def test_pictures_show_in_a_notebook(histories):
    assert mo.plot(histories["kalman"])._repr_png_().startswith(b"\x89PNG")


def test_many_histories_at_once_print(histories):
    many = jax.vmap(lambda key: mo.run(key, mo.ParticleFilter(n=5, on_collapse="predict"), STEADY, YS[:3]))(
        jax.random.split(jax.random.key(0), 2)
    )
    assert str(many) == repr(many)
