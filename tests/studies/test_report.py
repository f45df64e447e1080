"""The page of a study: whole, true to the numbers, and nothing in it comes alive that a user can name."""

import base64
import hashlib
import json
import re
from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np
import pytest

import motes as mo
from data import refused
from motes.core.checks import FileError
from motes.core.record import replace
from studied import RUNS, STEPS, made_result

VOID = {"meta", "input", "line", "br"}
HOSTILE = ("<script>alert(1)</script>", "</script><!--<script>", '"><img src=x onerror=alert(1)>', "a & b \u00e9", "${title}", "\u2028")


class Page(HTMLParser):
    """Tags of a page; refuses what is not closed in order."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.scripts, self.texts = [], [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag == "script":
            self.scripts.append([dict(attributes), ""])
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.open and self.open.pop() == tag, tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "script":
            self.scripts[-1][1] += data
        else:
            self.texts.append(data.strip())


def page_of(result, folder, **options):
    return Page(mo.report(result, folder / "report.html", **options).read_text())


@pytest.mark.parametrize("name", HOSTILE)
def test_nothing_that_a_user_names_comes_alive(tmp_path, name):
    result = replace(made_result(("ref", name)), labels=("A", name), blocks=((name, ("z", "x")), ("y", ("y",))), lost_beyond=(name, 40.0),
                     provenance=((name, name),))
    page = page_of(result, tmp_path, title=name)
    plain = page_of(made_result(), tmp_path)
    for tag in ("script", "img", "style", "meta", "iframe", "link"):
        assert [found[0] for found in page.tags].count(tag) == [found[0] for found in plain.tags].count(tag)
    assert len(page.scripts) == 3 and not any(key.startswith("on") for _, attributes in page.tags for key in attributes)
    data = page.scripts[0]
    assert data[0] == {"type": "application/json", "id": "data"} and not set(data[1]) & set("<>&\u2028\u2029")
    assert json.loads(data[1])["names"] == ["ref", name] and json.loads(data[1])["blocks"][0]["name"] == name
    assert page.texts.count(name.strip()) >= 4 or not name.strip()


def test_the_page_asks_no_network_and_knows_its_scripts(tmp_path):
    page = page_of(made_result(), tmp_path)
    assert not any(key in ("src", "href", "action", "data") for _, attributes in page.tags for key in attributes)
    style = re.search(r"<style>(.*?)</style>", (tmp_path / "report.html").read_text(), re.S)[1]
    assert "url(" not in style and "@import" not in style
    policy = next(attributes["content"] for _, attributes in page.tags if "default-src" in attributes.get("content", ""))
    assert "default-src 'none'" in policy and "unsafe-eval" not in policy and "http" not in policy
    for _, script in page.scripts[1:]:
        assert f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'" in policy
    assert len(page.scripts[1][1]) > 50_000 and "uPlot" in page.scripts[2][1]


def test_numbers_are_those_of_the_result(tmp_path):
    result = replace(made_result(), lost_beyond=("plane", 40.0))
    bound = SimpleNamespace(cov=np.tile(np.diag([1.0, 4.0, 9.0]), (STEPS, 1, 1)))
    page = page_of(result, tmp_path, bound=bound, seconds={"ref": 0.25})
    data = json.loads(page.scripts[0][1])
    assert data["steps"] == list(range(STEPS)) and [block["name"] for block in data["blocks"]] == ["plane", "y"]
    np.testing.assert_allclose(data["blocks"][0]["filters"], result.rmse_over_time("plane"), rtol=1e-4)
    np.testing.assert_allclose(data["blocks"][1]["bound"], 2.0)
    titles = [text for text in page.texts if text.startswith("run ")]
    assert len(titles) == 2 * 2 * RUNS
    assert f"run 4: {np.sqrt(result.squared_errors('plane')[1, 4].mean()):.4g}" in titles
    assert [tag for tag, attributes in page.tags].count("path") == 2  # the one lost run, in both strips
    assert "0.2500" in page.texts and "1.000" not in page.texts


def test_runs_that_are_not_numbers_leave_a_whole_page(tmp_path):
    page = page_of(replace(made_result(), estimates=np.full((2, RUNS, STEPS, 3), np.nan)), tmp_path)
    assert json.loads(page.scripts[0][1])["blocks"][0]["filters"] == [[None] * STEPS] * 2


def test_refusals(tmp_path):
    with pytest.raises(mo.MotesError) as error:
        mo.report(3, tmp_path / "report.html")
    refused(error, "report result: expected a StudyResult or a History, got int")
    with pytest.raises(FileError, match="expected a name that ends in .html, got .txt"):
        mo.report(made_result(), tmp_path / "report.txt")
    assert list(tmp_path.iterdir()) == []


def test_plot(tmp_path):
    result = replace(made_result(("_first", "$x$")), lost_beyond=("plane", 40.0))
    figure = mo.plot(result, bound=SimpleNamespace(cov=np.tile(np.diag([1.0, 4.0, 9.0]), (STEPS, 1, 1))))
    assert [axes.get_title() for axes in figure.axes] == ["RMSE of plane", "RMSE of y"]
    for axes, block in zip(figure.axes, ("plane", "y"), strict=True):
        np.testing.assert_allclose([line.get_ydata() for line in axes.lines[:2]], result.rmse_over_time(block))
    assert axes.lines[2].get_ydata() == pytest.approx(2.0) and axes.lines[2].is_dashed()
    figure.savefig(tmp_path / "study.png")
    assert [text.get_text().strip() for text in figure.legends[0].get_texts()] == ["_first", "$x$", "bound"]
