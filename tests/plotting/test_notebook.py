"""A notebook is executed: figures and tables are in its outputs, once each, long reprs and floods of progress are not."""

import pytest

CELLS = (
    "import numpy as np, jax, motes as mo",
    "model = mo.textbook.constant_velocity()\nxs, ys = mo.simulate(0, model, 20)\nhistory = mo.run(1, mo.KalmanFilter(), model, ys)",
    "mo.plot(history, truth=xs)",
    "history",
    "print(repr(history))",
    "forecast = mo.forecast(history, 5)\nforecast",
    "mo.plot(forecast)",
    "model",
    "mo.KalmanFilter()",
    "mo.structure(model)",
    "mo.diagnose(history)",
    "%matplotlib inline\nmo.plot(history, states=('px', 'py'))",
    "from motes.core.progress import tracked\nimport time\nfor _ in tracked(range(300), 'work', None): time.sleep(0.003)",
)


@pytest.fixture(scope="module")
def outputs():
    """What each cell gave."""
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    pytest.importorskip("matplotlib")
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in CELLS])
    nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3").execute()
    return {cell.source: cell.outputs for cell in notebook.cells}


def shown(outputs, cell, kind):
    found = [output.data[kind] for output in outputs[cell] if kind in output.get("data", {})]
    assert len(found) == 1, (cell, outputs[cell])
    return found[0]


@pytest.mark.parametrize("cell", [cell for cell in CELLS if "mo.plot" in cell])
def test_figures_show_once(outputs, cell):
    assert len(shown(outputs, cell, "image/png")) > 10_000
    assert sum(output.output_type != "stream" for output in outputs[cell]) == 1


@pytest.mark.parametrize("cell, words", [
    ("history", "log likelihood"), (CELLS[5], "y0"), ("model", "px, py, vx, vy"), ("mo.KalmanFilter()", "cost of a step"),
    ("mo.structure(model)", "Kalman"), ("mo.diagnose(history)", "Nothing wrong was found"),
])  # fmt: skip
def test_results_show_as_tables(outputs, cell, words):
    text = shown(outputs, cell, "text/markdown")
    assert words in text and ("|" in text or "Nothing" in text)


def test_a_history_prints_short(outputs):
    (printed,) = outputs["print(repr(history))"]
    assert len(printed.text) < 300 and "float32[20,4]" in printed.text


def test_progress_is_one_text_that_is_exchanged(outputs):
    (bar,) = outputs[CELLS[-1]]
    text = bar.data["text/plain"]
    assert "work" in text and "300/300" in text and len(text.splitlines()) == 1
