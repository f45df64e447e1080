"""Messages that come twice, late, out of order, or from a clock that was set."""

import json

import numpy as np
import pytest

import motes as mo
from live_parts import MODEL, Kept, form, run, same, texts, went
from motes.live.counts import Counts
from motes.live.message import Message
from motes.live.order import STUBBORN, Order
from motes.live.settings import Live


def moved(lines, moves):
    lines = list(lines)
    for place, later in moves:
        lines.insert(later, lines.pop(place))
    return lines


def messages(times, numbers=None, arrived=None):
    numbers = numbers or [None] * len(times)
    arrived = arrived or [None] * len(times)
    return [Message({"t": t, "place": place}, np.zeros(1), None, t, k, a, place)
            for place, (t, k, a) in enumerate(zip(times, numbers, arrived, strict=True))]  # fmt: skip


def after(count):
    """Ends a run after so many questions: at each message, and before each piece of them."""
    asked = iter(range(10**6))
    return lambda: next(asked) > count


def placed(times, numbers=None, arrived=None, **rules):
    """Of each message that was taken its place among those that came, how far back it went, and the time of the step."""
    counts = Counts()
    order, found = Order(Live(**rules), counts), []
    for message in messages(times, numbers, arrived):
        for one in order.take(message):
            again = order.back(one.back)
            found.append((one.message.content["place"], one.back, order.since(one)))
            for each in (one, *again):
                order.taken(each)
    for one in order.rest():
        found.append((one.message.content["place"], one.back, order.since(one)))
        order.taken(one)
    return found, counts.of


def test_folded_in_late_messages_leave_the_bits_of_a_run_in_order():
    lines = texts(30)
    ordered, whole = went(lines)
    found, late = went(moved(lines, [(4, 9), (11, 12), (20, 27)]))
    assert same(whole, late) and late.counts.of["late"] == 3 and late.counts.of["steps"] == 30
    assert [record["late"] for record in found if record["late"]] == [5, 1, 7] and found[-1] == ordered[-1]
    key, one = np.asarray(whole.stream.log_likelihood), np.asarray(late.stream.log_likelihood)
    assert key == one


def test_what_waits_comes_in_order_with_the_same_bits():
    lines = texts(30)
    whole = went(lines)[1]
    found, waited = went(moved(lines, [(4, 6), (11, 12)]), late="wait", wait=0.5)
    assert same(whole, waited) and waited.counts.of["sorted"] == 2
    assert [record["step"] for record in found] == list(range(30))


def test_what_is_later_than_all_waits_is_dropped_and_counted_once():
    times = [0.0, 0.1, 0.2, 0.3, 0.25, 0.05, 0.4]
    for wait, late in ((0.0, 2), (0.07, 1)):
        found, counts = placed(times, late="wait", wait=wait)
        assert (counts["dropped"], counts["sorted"], len(found)) == (late, 2 - late, 7 - late)


def test_what_waits_for_long_is_no_jump():
    times = [0.1 * k for k in range(300)]
    found, counts = placed(times, arrived=[5.0 + 0.1 * k for k in range(300)], late="wait", wait=20.0, jump=10.0)
    assert [one[2] for one in found] == [0.0, *np.diff(times)] and not counts["jumps"]


def test_duplicates_and_what_is_too_late_are_dropped_and_counted():
    lines = texts(30)
    twice = [line for line in lines for _ in range(2)]
    assert same(went(twice)[1], went(lines)[1])
    dropped = went(moved(lines, [(4, 9)]), late="drop")[1]
    assert dropped.counts.of["dropped"] == 1 and same(dropped, went(lines[:4] + lines[5:])[1])
    too_late = went(moved(lines, [(4, 9)]), lag=3)[1]
    assert too_late.counts.of["dropped"] == 1 and same(too_late, dropped)
    assert "30 taken" in went(twice, duplicate="drop")[1].counts.told()
    assert "came before and were dropped" in went(twice)[1].counts.told()


def test_two_sensors_of_one_time_are_two_steps_and_the_same_twice_is_one():
    found, counts = placed([0.0, 1.0, 1.0, 2.0])
    assert [one[0] for one in found] == [0, 1, 2, 3]
    order = Order(Live(), counts := Counts())
    for message in 2 * messages([0.0]):
        for one in order.take(message):
            order.taken(one)
    assert counts.of["duplicates"] == 1


def test_numbers_that_never_came_are_counted():
    found, counts = placed([0.0, 0.1, 0.4, 0.2], [0, 1, 4, 2])
    assert [one[1] for one in found] == [0, 0, 0, 1] and counts["missing"] == 1


def test_a_clock_that_was_set_back_counts_the_usual_step():
    found, counts = placed([100.0, 100.1, 100.2, 3.0, 3.1, 3.2])
    assert np.allclose([one[2] for one in found], [0.0, *5 * [0.1]]) and counts["jumps"] == 1


def test_a_clock_ahead_is_told_from_a_pause_by_the_clock_of_this_machine():
    ahead, counts = placed([0.0, 0.1, 3600.0, 3600.1], arrived=[5.0, 5.1, 5.2, 5.3])
    assert np.allclose([one[2] for one in ahead], [0.0, 0.1, 0.1, 0.1]) and counts["jumps"] == 1
    pause, counts = placed([0.0, 0.1, 3600.0, 3600.1], arrived=[5.0, 5.1, 3605.0, 3605.1])
    assert np.allclose([one[2] for one in pause], [0.0, 0.1, 3599.9, 0.1]) and not counts["jumps"]
    recorded, counts = placed([0.0, 0.1, 3600.0, 3600.1])
    assert np.allclose([one[2] for one in recorded], [0.0, 0.1, 3599.9, 0.1]) and not counts["jumps"]


def test_a_jump_stops_or_begins_anew_where_that_is_asked_for():
    with pytest.raises(mo.MotesError, match="clock_jump.*expected messages in order, and times within 10 s, got .* went 97.2 s back"):
        placed([100.0, 100.2, 3.0], clock_jump="stop")
    lines = texts(30)
    sink = Kept()
    anew = run(lines[10:] + lines[:5], sink=sink, clock_jump="begin anew", jump=0.5)
    anew.go(lambda: False)
    assert same(anew, went(lines[:5])[1]) and anew.counts.of["jumps"] == 1 and sink.records[-1]["step"] == 4


def test_a_source_that_began_anew_is_followed_after_a_few_messages():
    times = [*(5.0 + 0.1 * k for k in range(30)), *(0.1 * k for k in range(2 * STUBBORN))]
    found, counts = placed(times, [*range(1000, 1030), *range(2 * STUBBORN)], lag=3)
    assert counts["dropped"] == STUBBORN - 1 and counts["jumps"] == 1 and len(found) == 30 + STUBBORN + 1


def test_the_window_and_what_waits_survive_a_checkpoint(tmp_path):
    for rules in ({}, {"late": "wait", "wait": 0.35}):
        lines = moved(texts(40), [(4, 7), (18, 20), (21, 24), (30, 33)])
        whole = went(lines, **rules)
        for place in (19, 22, 23):
            path, sink = tmp_path / f"{place}{len(rules)}.npz", Kept()
            run(lines, path, sink, **rules).go(after(place))
            again = run(lines, path, sink, **rules)
            assert again.restore() and again.stream.t < 39
            again.go(lambda: False)
            assert same(whole[1], again) and sink.records == whole[0], (rules, place)
            assert again.counts.of == whole[1].counts.of


def test_a_form_needs_the_inputs_first():
    assert form().needed == ("push",) and MODEL.names == ("east",)


def test_a_wild_number_is_refused_and_what_follows_is_in_order():
    times, numbers = [0.1 * k for k in range(60)], [k if k != 5 else 10**12 for k in range(60)]
    for rules in ({}, {"late": "drop"}, {"late": "wait"}):
        found, counts = placed(times, numbers, **rules)
        assert [one[0] for one in found] == [k for k in range(60) if k != 5] and counts["wild"] == 1 and not counts["late"], rules
        assert min(one[2] for one in found) >= 0
    found, counts = placed([0.0, 0.1, 0.2, 3600.0, 3600.1], [0, 1, 2, 36_000, 36_001])
    assert len(found) == 5 and not counts["wild"], "a long pause may lose many"
    found, counts = placed(times, [k if k < 5 else k + 10**9 for k in range(60)])
    assert len(found) == 60 - STUBBORN + 1 and counts["jumps"] == 1, "numbers that stay there are a source that began anew"


def test_a_step_never_takes_less_than_no_time(caplog):
    found, counts = placed([0.0, 10.0, 11.0, 2.0, 3.0, 4.0], list(range(6)))
    assert [one[2] for one in found] == [0.0, 10.0, 1.0, 0.0, 1.0, 1.0] and counts["backward"] == 1
    assert [one.getMessage() for one in caplog.records] == ["the time goes back by 9 s at message 3, and counts as a step of 0 s."]


@pytest.mark.parametrize("again", [lambda t: t + 30.0, lambda t: t], ids=["later", "to the bit"])
def test_a_source_that_began_anew_loses_twenty_at_most(again):
    times = [0.1 * k for k in range(100)]
    found, counts = placed([*times, *map(again, times)], 2 * list(range(100)), duplicate="drop")
    assert counts["jumps"] == 1 and len(found) == 200 - STUBBORN + 1
    assert min(one[2] for one in found) >= 0 and not counts["late"]
    same = [one for one in messages(times, list(range(100))) for _ in range(2)]
    order = Order(Live(), counts := Counts())
    for one in (*same[::2], *same[::2]):
        for each in order.take(one):
            order.taken(each)
    assert counts.of["duplicates"] == STUBBORN - 1 and counts.of["jumps"] == 1


def test_a_wild_time_does_not_poison_what_follows():
    times = [1.7e9 + 0.1 * k if k != 20 else 1e11 for k in range(40)]
    for rules in ({}, {"late": "wait", "wait": 0.3}):
        found, counts = placed(times, **rules)
        assert [one[0] for one in found] == list(range(40)) and np.allclose([one[2] for one in found][21:], 0.1, atol=1e-5), rules
        assert counts["jumps"] == 1


def test_what_waited_is_taken_before_a_clock_that_was_set_back():
    times = [500 + 0.1 * k for k in range(10)] + [0.1 * k for k in range(20)]
    for numbers in (None, list(range(30))):
        found, counts = placed(times, numbers, late="wait", wait=0.5)
        assert [one[0] for one in found] == list(range(30)) and counts["jumps"] == 1 and not counts["dropped"]
        assert np.allclose([one[2] for one in found][1:], 0.1)


def test_a_restart_among_messages_without_place_has_the_same_bits(tmp_path):
    rows = [json.loads(line) for line in texts(70)]
    lines = [json.dumps(row | {"k": row["k"] + 2000 * (row["k"] < 30)}).encode() for row in rows]
    lines[33:33] = [b"no message", b"neither"]
    whole = went(lines, lag=3)
    for place in (38, 45):
        path, sink = tmp_path / f"{place}.npz", Kept()
        run(lines, path, sink, lag=3).go(after(place))
        again = run(lines, path, sink, lag=3)
        assert again.restore() and again.stream.t == 29 and again.order._stubborn > 0
        again.go(lambda: False)
        assert same(whole[1], again) and sink.records == whole[0] and again.counts.of == whole[1].counts.of


def test_what_no_particle_explained_is_counted_once_however_often_it_is_taken():
    lines = texts(12)
    lines[8] = json.dumps(json.loads(lines[8]) | {"a": 1e9}).encode()
    found = went(moved(lines, [(4, 9), (6, 10)]))[1]
    assert found.counts.of["late"] == 2 and found.counts.of["collapsed"] == 1


def test_what_comes_twice_while_all_waits_is_no_source_that_began_anew(tmp_path):
    lines = [line for line in texts(STUBBORN + 5) for _ in range(2)]
    ordered, _ = went(lines[::2])
    found, whole = went(lines, late="wait", wait=10.0)
    assert found == ordered and whole.counts.of["duplicates"] == len(ordered) and not whole.counts.of["jumps"]
    # so it is where it was killed among them
    sink = Kept()
    run(lines, tmp_path / "run.npz", sink, late="wait", wait=1.0).go(after(30))
    again = run(lines, tmp_path / "run.npz", sink, late="wait", wait=1.0)
    assert again.restore()
    again.go(lambda: False)
    assert sink.records == ordered


@pytest.mark.parametrize("rules", [{}, {"late": "wait", "wait": 0.25}])
def test_the_message_at_which_a_clock_stopped_the_run_is_taken_by_one_that_goes_on(tmp_path, rules):
    lines = texts(12)
    lines[6:] = [json.dumps(json.loads(line) | {"t": json.loads(line)["t"] - 100.0}).encode() for line in lines[6:]]
    sink = Kept()
    for _ in range(2):
        first = run(lines, tmp_path / "run.npz", sink, clock_jump="stop", **rules)
        first.restore()
        with pytest.raises(mo.MotesError, match="clock_jump"):
            first.go(lambda: False)
        assert [record["number"] for record in sink.records] == list(range(6))
    again = run(lines, tmp_path / "run.npz", sink, **rules)
    assert again.restore()
    again.go(lambda: False)
    assert [record["number"] for record in sink.records] == list(range(12))


def test_inputs_of_what_was_not_taken_at_the_end_do_not_hold(tmp_path):
    """Twice, too late, at a place before, without a time, or beyond the numbers of the filter: the next without inputs has those before."""
    lines = [json.loads(line) for line in texts(8)]
    last = {name: value for name, value in lines.pop().items() if name != "push"}
    came = [lines[0] | {"push": 70.0}, lines[2], {"k": 6, "a": 1.0, "push": 80.0}, lines[4] | {"t": 0.65, "push": 1e300}]
    late = lines.pop(5)
    ordered = [json.dumps(one).encode() for one in (*lines[:5], late, *lines[5:], last)]
    found = [json.dumps(one).encode() for one in (*lines, late, *came, last)]
    sink = Kept()
    run(found[:-1], tmp_path / "run.npz", sink, lag=3).go(lambda: False)
    again = run(found, tmp_path / "run.npz", sink, lag=3)
    assert again.restore()
    again.go(lambda: False)
    assert same(again, went(ordered)[1])
    assert [again.counts.of[kind] for kind in ("late", "dropped", "duplicates", "unreadable")] == [1, 1, 1, 2]
