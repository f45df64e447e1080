"""The page in a real browser: what moves, how often, what is asked for, what a finger and a keyboard do."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import chromium
import pytest
from looked_at import small_stream, stepped

import motes as mo

pytest.importorskip("uvicorn")
pytest.importorskip("websockets")
pytestmark = pytest.mark.skipif(chromium.PROGRAM is None, reason=chromium.MISSING)
COMMAND = "import sys; from motes.cli.main import main; sys.exit(main())"
UPDATES = "Number(document.getElementById('rate')?.dataset.updates || 0)"
STEP = "Number(document.querySelector('#numbers dd').textContent)"
PIXELS = "document.getElementById('cloud').toDataURL()"
KEPT = Path(os.environ.get("MOTES_SHOTS", Path(__file__).parents[2] / "out" / "shots"))
DEMOS = {"terrain": (), "robot": (), "aircraft": (), "laser": ("--filter", "particle"), "slam": (), "notch": ("--scans", "300"),
         "video": (), "modes": ()}  # fmt: skip


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with chromium.Chromium(tmp_path_factory.mktemp("chromium")) as found:
        yield found


def clean(tab, port):
    """Assert that a page complained of nothing and asked nobody else."""
    assert tab.said == []
    own = (f"http://127.0.0.1:{port}/", f"ws://127.0.0.1:{port}/", "data:", "blob:")
    assert [address for address in tab.asked if not address.startswith(own)] == []


def test_a_page_shows_moves_and_obeys_the_keyboard(browser):
    stream = small_stream(500)
    page = mo.watch(stream)
    port = page._guard.port
    tab = browser.tab(page.address)
    try:
        stepped(stream, page, 5)
        tab.waits(f"{UPDATES} > 0")
        before = tab.tells(PIXELS)
        for value in (1.0, 2.0, 3.0):
            stepped(stream, page, 1, value)
            time.sleep(0.1)
        tab.waits("document.querySelector('#numbers dd').textContent === '7'")
        assert tab.tells(PIXELS) != before
        tab.presses(" ")
        assert tab.tells("document.getElementById('pause').textContent") == "Play"
        tab.presses("ArrowLeft")
        tab.waits("document.getElementById('status').textContent.includes('paused here')")
        stepped(stream, page, 1)
        tab.presses("End")
        tab.waits("document.getElementById('status').textContent === 'live'")
        tab.presses("x")
        tab.waits("document.getElementById('x').value === '1'")
        tab.presses("t")
        assert tab.tells("document.documentElement.dataset.theme") == "dark"
        page.end("ended", page.report())
        tab.waits("!document.getElementById('report').hidden")
        tab.does("Page.navigate", url=f"http://127.0.0.1:{port}/report")
        tab.waits("document.querySelectorAll('figure canvas').length >= 2 && document.querySelectorAll('.uplot').length >= 2")
        # on a narrow screen no name is broken, and marks of a logarithmic axis do not run into one another
        tab.tells("document.body.style.width = '340px'")
        names = "[...document.querySelectorAll('.wide td:first-child')].filter(cell => cell.textContent === 'steps')"
        assert tab.tells(f"{names}.length === 1 && {names}[0].clientHeight < 40")
        marks = "motesCloud.chartAxes(true, {}, {})[1].ticks.filter"
        assert tab.tells(f"{marks}(null, [0.5, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 1000]).filter(mark => mark !== null)") == [1, 10, 1000]
        assert tab.tells(f"{marks}(null, [4, 5, 6]).length") == 3
        clean(tab, port)
    finally:
        tab.close()
        page.close()


def watched(words):
    """A demonstration at work in a process of its own, and its link."""
    there = subprocess.Popen([sys.executable, "-c", COMMAND, *words], stdout=subprocess.PIPE, text=True, start_new_session=True)
    for line in there.stdout:
        found = re.search(r"http\S+token=\S+", line)
        if found:
            return there, found[0]
    raise AssertionError("no link was printed")


@pytest.mark.night
@pytest.mark.parametrize("name", DEMOS)
def test_each_demonstration_moves_in_the_browser(browser, tmp_path, name):
    size = "200" if name == "slam" else "2000"
    there, link = watched(["demo", name, "--watch", "--no-browser", "--rate", "30", *DEMOS[name], "--n", size, "--out", str(tmp_path)])
    port = re.search(r":(\d+)/", link)[1]
    try:
        first = browser.tab(link)
        first.waits(f"{UPDATES} > 10", 120)
        pixels, count, step, began = first.tells(PIXELS), first.tells(UPDATES), first.tells(STEP), time.monotonic()
        time.sleep(3)
        after, taken = first.tells(UPDATES) - count, first.tells(STEP) - step
        rate = after / (time.monotonic() - began)
        assert first.tells(PIXELS) != pixels
        clean(first, port)
        first.close()
        for size, mobile in (((1280, 900), False), ((390, 844), True)):
            for dark in (False, True):
                tab = browser.tab(link, size, dark, mobile)
                # a clip may be over by now, whose last picture stays
                tab.waits(f"{UPDATES} > 2 || document.getElementById('status')?.textContent.startsWith('ended')")
                time.sleep(0.5)
                assert tab.tells("document.documentElement.scrollWidth") <= size[0]
                tab.picture(KEPT / f"{name}_{size[0]}_{'dark' if dark else 'light'}.png", whole=mobile)
                clean(tab, port)
                tab.close()
        print(f"{name}: {rate:.1f} updates a second, {after} of {taken} steps")
        # a filter that takes fewer steps than that is shown step by step
        assert rate >= 20 or after >= 0.9 * taken
    finally:
        os.killpg(there.pid, signal.SIGKILL)
        there.wait()
