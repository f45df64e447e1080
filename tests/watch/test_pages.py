"""What a page is told is what the stream has, and the stream does not feel it."""

import threading
import time

import jax
import numpy as np
import pytest
from looked_at import NAMES, answer, connected, entered, get, question, small_model, small_stream, stepped

import motes as mo
from motes.core.checks import MotesError
from motes.report.film import LEADING
from motes.report.scene import Scene
from motes.watch.recorder import WAITING

pytest.importorskip("uvicorn")
WIDTH = len(LEADING) + 3 * len(NAMES)


def shown(page, steps=1, stream=None, axes=(0, 1), **changes):
    """What a page is told once a stream has taken some steps."""
    if stream is not None:
        stepped(stream, page, steps)
        waited(lambda: page._recorder.newest is not None and page._recorder.newest.step == stream.t)
    with connected(*entered(page)) as watching:
        for _ in range(100):
            watching.send(question(axes=list(axes), **changes))
            found = answer(watching.recv(timeout=20), len(LEADING) + 3 * stream.model.size if stream else WIDTH)
            if found[2] is not None:
                return found
    raise AssertionError("no moment came")


@pytest.fixture
def opened():
    pages = []
    yield lambda *arguments, **options: pages.append(mo.watch(*arguments, **options)) or pages[-1]
    for page in pages:
        page.close()


def waited(condition):
    end = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_page_shows_the_law_of_the_stream(opened):
    stream = small_stream()
    truth = np.zeros((50, 3))
    page = opened(stream, truth=truth, budget=1e-9)
    for _ in range(9):
        stepped(stream, page, 1)
    stream.predict()
    stream.update(np.zeros(2, np.float32))
    page.show(seconds=0.5, time=12.25)
    waited(lambda: page._recorder.newest is not None and page._recorder.newest.step == 9)
    header, rows, (points, weights) = shown(page)
    law = stream.state
    np.testing.assert_allclose(points, np.asarray(law.particles)[:2], atol=1e-3)
    np.testing.assert_allclose((weights / 255) ** 2, np.exp(law.log_weights - law.log_weights.max()), atol=0.01)
    frame = header["frame"]
    np.testing.assert_allclose(frame["mean"], np.asarray(stream.mean)[:2], atol=1e-5)
    np.testing.assert_allclose(frame["cov"], np.asarray(stream.cov)[[0, 0, 1], [0, 1, 1]], atol=1e-5)
    assert frame["time"] == 12.25 and frame["truth"] == [0, 0] and header["live"] and header["state"] == "live"
    assert header["taken"] == header["late"] == 10
    assert header["log_likelihood"] == pytest.approx(float(stream.log_likelihood), rel=1e-5)
    assert rows[-1, 0] == 9 and rows[-1, LEADING.index("error")] == pytest.approx(float(np.hypot(*stream.mean[:2])), rel=1e-3)
    assert rows[-1, LEADING.index("ess")] == pytest.approx(float(stream.info.ess), rel=1e-5) or len(rows) < 10


@pytest.mark.optimized
def test_a_stream_that_is_watched_has_the_bits_of_a_run(opened):
    _, ys = mo.simulate(1, small_model(), 12)
    alone = mo.run(0, mo.ParticleFilter(n=200), small_model(), ys)
    stream = small_stream()
    page = opened(stream)
    for place, y in enumerate(ys):
        if place:
            stream.predict()
        stream.update(y)
        page.show()
    waited(lambda: page._recorder.newest is not None and page._recorder.newest.step == 11)
    assert all(map(np.array_equal, jax.tree.leaves(stream.state), jax.tree.leaves(alone.state)))


def test_a_page_that_asks_nothing_is_sent_nothing(opened):
    stream = small_stream()
    page = opened(stream)
    stepped(stream, page, 1)
    port, cookie = entered(page)
    with connected(port, cookie) as watching:
        stepped(stream, page, 300)
        with pytest.raises(TimeoutError):
            watching.recv(timeout=0.3)
        waited(lambda: page._recorder.newest.step == 300)
        watching.send(question())
        header, rows, _ = answer(watching.recv(timeout=20), WIDTH)
        assert header["frame"]["step"] == 300 and header["taken"] == 301
        # nothing new: it is told so after a while, without a moment
        watching.send(question(have=header["frame"]["number"], generation=0, rows=len(rows), state="live"))
        again, none, frame = answer(watching.recv(timeout=20), WIDTH)
        assert frame is None and len(none) == 0 and again["rows"]["from"] == len(rows)


def test_pages_go_back_in_time_each_for_itself(opened):
    stream = small_stream()
    page = opened(stream)
    for step in range(5):
        stepped(stream, page, 1, value=float(step))
        waited(lambda step=step: page._recorder.newest is not None and page._recorder.newest.step == step)
    first = shown(page, at=0)[0]
    assert first["frame"]["step"] == 0 and not first["live"] and first["reel"] == [0, 4, 5]
    assert shown(page, at=0, by=2, axes=(2, 1))[0]["frame"]["step"] == 2
    assert shown(page, at=2, by=-1)[0]["frame"]["step"] == 1 and shown(page)[0]["frame"]["step"] == 4


@pytest.mark.parametrize("filter", [mo.KalmanFilter(), mo.MarginalizedParticleFilter(n=50), mo.EnsembleKalmanFilter(n=50)], ids=repr)
def test_other_laws_are_drawn_too(opened, filter):
    stream = mo.stream(0, filter, small_model())
    page = opened(stream)
    header, _, (points, _) = shown(page, 2, stream)
    assert points.shape[1] >= 50 and np.isfinite(points).all()
    np.testing.assert_allclose(header["frame"]["mean"], np.asarray(stream.mean)[:2], atol=1e-2)


def test_one_state_is_drawn_over_time(opened):
    stream = small_stream(names=("level",))
    page = opened(stream, truth=np.zeros((9, 1)))
    header, rows, (points, _) = shown(page, 3, stream, axes=(-1, 0))
    assert (points[0] == header["frame"]["time"]).all() and rows.shape[1] == len(LEADING) + 3


def test_double_precision_is_that_of_who_opened_the_page(opened):
    with jax.enable_x64(True):
        stream = small_stream()
        page = opened(stream)
        header = shown(page, 3, stream)[0]
        assert stream.mean.dtype == np.float64
    assert header["frame"]["step"] == 2


def test_what_cannot_be_drawn_stops_nobody(opened, caplog):
    stream = small_stream()

    def place(points, u, step):
        if step == 1:
            raise ValueError("nowhere")
        return points

    page = opened(stream, Scene(names=NAMES, place=place))
    for step in range(3):
        stepped(stream, page, 1)
        waited(lambda step=step: step == 1 and "nowhere" in caplog.text or step != 1 and page._recorder.newest is not None
               and page._recorder.newest.step == step)  # fmt: skip
    assert shown(page)[0]["frame"]["step"] == 2


def test_alarms_are_told_in_words(opened):
    stream = small_stream()
    page = opened(stream)
    stepped(stream, page, 5)
    waited(lambda: page._recorder._judged > 0)
    page._recorder._judged = -np.inf
    for value in (30.0, -30.0) * 5:
        stepped(stream, page, 1, value)
    waited(lambda: page._recorder.findings)
    found = shown(page)[0]
    assert found["findings"] and all(one["text"] and one["name"] for one in found["findings"]) and found["told"]


def test_the_filter_is_told_as_it_is_at_work(opened):
    """Not as it was when the page was opened: a budget may choose another number of particles."""
    stream = small_stream()
    page = opened(stream)
    assert shown(page, stream=stream)[0]["filter"] == repr(stream.filter)
    stream.resize(stream.filter.with_particles(77))
    found = shown(page, stream=stream)[0]["filter"]
    assert found == repr(stream.filter) and "n=77" in found and "n=77" in page.report()


def test_rows_are_thinned_and_alarms_stay(opened):
    recorder = opened(small_stream())._recorder
    for step in range(20_000):
        told = np.zeros(len(recorder.columns))
        told[0], told[LEADING.index("alarm")] = step, step in (15_001, 19_997)
        recorder._keep(told)
    steps = recorder.rows[: recorder.count, 0]
    assert recorder.count <= 4_096 and (np.diff(steps) > 0).all() and steps[0] == 0 and 19_997 in steps
    assert recorder.generation > 1 and np.diff(steps).max() < 40


@pytest.mark.parametrize("looked", [0, 3], ids=["never", "a while ago"])
def test_a_report_is_of_every_step_however_seldom_the_page_looked(opened, looked):
    stream = small_stream()
    page = opened(stream, budget=1e-9)
    recorder = page._recorder
    stepped(stream, page, looked)
    turn, recorder.turn = recorder.turn, lambda: False  # the thread of the page looks no more
    turn()
    for value in (30.0, -30.0) * 5:
        stepped(stream, page, 1, value)
    stepped(stream, page, 250)
    recorder.turn = turn
    film = recorder.film("x")
    facts = dict(film.facts)
    assert facts["steps"] == str(looked + 260) and facts["late steps"].startswith(f"{looked + 260} took") and "judged" not in facts
    assert float(facts["log likelihood"]) == pytest.approx(float(stream.log_likelihood), rel=1e-4)
    # what was wrong lies further back than what the page judges
    assert "alarm" in [one.name for one in film.findings] and film.frames[-1].step == stream.t
    if not looked:
        # programs are compiled meanwhile: the first steps wait to be drawn
        assert film.rows[:64, 0].tolist() == list(range(64)) and film.rows[-1, 0] == stream.t and len(film.frames) == 12


def test_steps_whose_records_had_to_go_are_told(opened):
    stream = small_stream()
    page = opened(stream)
    recorder = page._recorder
    turn, recorder.turn = recorder.turn, lambda: False
    stepped(stream, page, 1)
    for _ in range(WAITING + 5):
        page.show(seconds=1e-3)
    recorder.turn = turn
    facts = dict(recorder.film("x").facts)
    assert facts["steps"] == str(WAITING + 6) and facts["without a record"].startswith("6 steps")
    assert facts["judged"] == f"the last {WAITING} steps"


def test_the_end_is_told_with_its_report(opened):
    stream = small_stream(names=("<b>east</b>", "</script>", "x"))
    page = opened(stream, title="<img src=x onerror=alert(1)>")
    port, cookie = entered(page)
    assert get(port, "/report", Cookie=cookie)[0] == 404
    shown(page, 3, stream)
    page.end("ended", page.report("<script>alert(1)</script>"))
    header = shown(page, state="live", have=0)[0]
    assert header["state"] == "ended" and header["report"]
    status, text = get(port, "/report", Cookie=cookie)
    assert status == 200 and "<script>alert" not in text and "&lt;script&gt;alert(1)" in text and text.count("<script") == 4
    assert "\\u003cb\\u003eeast" in text and "<b>east" not in text and "default-src 'none'" in text


def test_notebooks_get_a_frame(opened):
    page = opened(small_stream())
    assert page._repr_html_().startswith(f'<iframe src="http://localhost:{entered(page)[0]}/?token=') and page.address in repr(page)
    assert "frame-ancestors http://localhost:*" in get(entered(page)[0], f"/?token={page.address.partition('token=')[2]}")[1]


def test_showing_neither_waits_nor_computes(opened):
    """What is left in the slot is left as it is: only references are taken."""
    stream = small_stream()
    page = opened(stream)
    stepped(stream, page, 1)
    page._recorder.turn = lambda: False
    waited(lambda: True)
    for _ in range(25_000):
        page.show(seconds=1e-3)
    assert len(page._recorder._steps) <= 20_000 and page._recorder._slot.held is stream.held


def test_pages_of_threads_are_independent(opened):
    pages, streams = [], [small_stream(), small_stream()]

    def work(stream):
        pages.append(opened(stream))
        stepped(stream, pages[-1], 5)

    threads = [threading.Thread(target=work, args=(stream,)) for stream in streams]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    ports = [entered(page) for page in pages]
    assert ports[0][0] != ports[1][0] and get(ports[0][0], "/scene", Cookie=ports[1][1])[0] == 401


@pytest.mark.parametrize("options, words", [
    ({"truth": np.zeros((3, 2))}, "watch truth: expected shape"),
    ({"scene": Scene(names=NAMES), "truth": np.zeros((3, 3))}, "watch truth: expected none beside a scene"),
    ({"budget": -1}, "watch budget: expected a number above 0"),
    ({"port": 70_000}, "watch port: expected a whole number from 0 to 65535"),
    ({"port": True}, "watch port"),
    ({"host": "nowhere.invalid"}, "watch host: expected an address of this machine"),
    ({"host": ""}, "watch host: expected an address of this machine, got ''"),
    ({"host": 5}, "watch host: expected an address of this machine, got 5"),
    ({"truth": [[1, 2], [3]]}, "watch truth: expected an array of numbers"),
    ({"scene": 5}, "watch scene: expected a Scene .*, got int"),
    ({"title": 5}, "watch title: expected a text, got int"),
])  # fmt: skip
def test_what_does_not_fit_is_refused(options, words):
    with pytest.raises(MotesError, match=words):
        mo.watch(small_stream(), **options)


@pytest.mark.parametrize("given, words", [
    ({"seconds": "a"}, "show seconds: expected a number, or None, got dtype <U1"),
    ({"time": "b"}, "show time: expected a number, or None"),
    ({"time": np.zeros(2)}, "show time: expected a number, or None, got shape .2,."),
    ({"picture": "no"}, "show picture: expected an array of uint8, .height, width, 3., got str"),
    ({"picture": np.zeros((4, 4, 3))}, "show picture: .* got float64 .4, 4, 3."),
    ({"picture": np.zeros((4, 4), np.uint8)}, "show picture: .* got uint8 .4, 4."),
])  # fmt: skip
def test_what_cannot_be_shown_is_refused_at_the_call(opened, given, words):
    stream = small_stream()
    page = opened(stream)
    with pytest.raises(MotesError, match=words):
        page.show(**given)
    assert page._recorder._slot is None
    stepped(stream, page, 1)
    page.show(np.float32(1), np.array(2), np.zeros((4, 5, 3), np.uint8))
    page.report()
    assert page._recorder.newest.time == 2 and page._recorder.newest.picture


def test_a_port_that_is_taken_is_told(opened):
    port = entered(opened(small_stream()))[0]
    with pytest.raises(MotesError, match=f"watch port: expected one that is free, got {port}, which another program listens at"):
        mo.watch(small_stream(), port=port)
    with pytest.raises(MotesError, match="watch stream: expected what mo.stream gave, got int"):
        mo.watch(3)
