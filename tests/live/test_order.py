"""Messages that come twice, late, out of order, or from a clock that was set."""

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
    return [Message({"t": t, "place": place}, np.zeros(1), None, t, k, a) for place, (t, k, a) in enumerate(zip(times, numbers, arrived,
                                                                                                                 strict=True))]  # fmt: skip


def after(count):
    """Ends a run after so many questions: at each message, and before each piece of them."""
    asked = iter(range(10**6))
    return lambda: next(asked) > count


def placed(times, numbers=None, arrived=None, **rules):
    """Of each message that was taken its place among those that came, how far back it went, and its time."""
    counts = Counts()
    order, found = Order(Live(**rules), counts), []
    for message in messages(times, numbers, arrived):
        for one in order.take(message):
            order.back(one.back)
            order.taken(one)
            found.append((one.message.content["place"], one.back, one.time))
    for one in order.rest():
        order.taken(one)
        found.append((one.message.content["place"], one.back, one.time))
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


def test_what_waits_for_long_is_no_jump():
    times = [0.1 * k for k in range(300)]
    found, counts = placed(times, arrived=[5.0 + 0.1 * k for k in range(300)], late="wait", wait=20.0, jump=10.0)
    assert [one[2] for one in found] == times and not counts["jumps"]


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
    for message in (messages([0.0])[0], messages([0.0])[0]):
        for one in order.take(message):
            order.taken(one)
    assert counts.of["duplicates"] == 1


def test_numbers_that_never_came_are_counted():
    found, counts = placed([0.0, 0.1, 0.4, 0.2], [0, 1, 4, 2])
    assert [one[1] for one in found] == [0, 0, 0, 1] and counts["missing"] == 1


def test_a_clock_that_was_set_back_counts_the_usual_step():
    found, counts = placed([100.0, 100.1, 100.2, 3.0, 3.1, 3.2])
    assert np.allclose([one[2] for one in found], [100.0, 100.1, 100.2, 100.3, 100.4, 100.5]) and counts["jumps"] == 1


def test_a_clock_ahead_is_told_from_a_pause_by_the_clock_of_this_machine():
    ahead, counts = placed([0.0, 0.1, 3600.0, 3600.1], arrived=[5.0, 5.1, 5.2, 5.3])
    assert np.allclose([one[2] for one in ahead], [0.0, 0.1, 0.2, 0.3]) and counts["jumps"] == 1
    pause, counts = placed([0.0, 0.1, 3600.0, 3600.1], arrived=[5.0, 5.1, 3605.0, 3605.1])
    assert np.allclose([one[2] for one in pause], [0.0, 0.1, 3600.0, 3600.1]) and not counts["jumps"]
    recorded, counts = placed([0.0, 0.1, 3600.0, 3600.1])
    assert np.allclose([one[2] for one in recorded], [0.0, 0.1, 3600.0, 3600.1]) and not counts["jumps"]


def test_a_jump_stops_or_begins_anew_where_that_is_asked_for():
    with pytest.raises(mo.MotesError, match="clock_jump.*expected times within 10 s, got 97.2 s back"):
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
