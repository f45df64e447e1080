"""Moments as pages show them: coordinates, whole numbers, what is kept of the past."""

import numpy as np
import pytest
from looked_at import points_of

from motes.core.checks import MotesError
from motes.report.film import KEPT_POINTS, MOST_POINTS, Reel, Seen, error_of, frame, row
from motes.report.scene import Scene, scene_of

PLANE = scene_of(("a", "b"))


def cloud(n=500, x=2, seed=0):
    rng = np.random.default_rng(seed)
    log_weights = rng.normal(size=n)
    return Seen(np.arange(x, dtype=float), np.eye(x), rng.normal(size=(x, n)), log_weights)


def back(one, axes=(0, 1)):
    """Points of a moment as a page reads them."""
    header, body = one.along(axes)
    return header, *points_of(header, body)


def test_points_and_weights_come_back():
    seen = cloud()
    header, points, weights = back(frame((3, 7, 1.5), seen, PLANE))
    np.testing.assert_allclose(points, seen.points, atol=8 / 65535)
    np.testing.assert_allclose((weights / 255) ** 2, np.exp(seen.log_weights - seen.log_weights.max()), atol=0.005)
    assert (header["number"], header["step"], header["time"]) == (3, 7, 1.5) and header["mean"] == [0, 1]
    assert header["cov"] == [1, 0, 1] and header["truth"] == [None, None]


def test_what_has_no_weight_or_is_no_number_is_left_out():
    seen = cloud(6)
    seen.log_weights[:3] = -np.inf
    seen.points[0, 3] = np.nan
    assert back(frame((0, 0, np.nan), seen, PLANE))[0]["count"] == 2
    seen.log_weights[:] = -np.inf
    header, points, _ = back(frame((0, 0, np.nan), seen, PLANE))
    assert points.shape == (2, 0) and header["low"] == [0, 1]
    nowhere = Seen(np.full(2, np.nan), np.full((2, 2), np.nan), np.full((2, 3), np.inf), np.zeros(3))
    header, body = frame((0, 0, np.nan), nowhere, PLANE).along((0, 1))
    assert header["count"] == 0 and body == b"" and header["mean"] == header["low"] == [None, None] and header["cov"] == [None] * 3


@pytest.mark.parametrize("n", [1, 2, MOST_POINTS, MOST_POINTS + 1, 5 * MOST_POINTS - 1])
def test_at_most_so_many_are_drawn_and_fewer_kept(n):
    one = frame((0, 0, np.nan), Seen(np.zeros(2), np.eye(2), np.zeros((2, n), np.float32), np.zeros(n, np.float32)), PLANE)
    assert one.points.shape[1] == one.weights.size <= MOST_POINTS and one.points.shape[1] >= min(n, MOST_POINTS // 2)
    assert one.thinned(KEPT_POINTS).points.shape[1] <= KEPT_POINTS


def test_a_law_without_particles_is_drawn_by_its_moments():
    cov = np.array([[4.0, 1.0], [1.0, 0.5]])
    _, points, _ = back(frame((0, 0, np.nan), Seen(np.array([1.0, -2.0]), cov), PLANE))
    np.testing.assert_allclose(points.mean(axis=1), [1, -2], atol=0.5)
    np.testing.assert_allclose(np.cov(points), cov, atol=0.9)


def test_moments_go_through_the_coordinates():
    matrix, shift = np.array([[2.0, 0.5], [0.0, -1.0], [1.0, 1.0]]), np.array([[10.0], [20.0], [30.0]])
    scene = Scene(names=("p", "q", "r"), place=lambda points, u, step: matrix @ points + u * shift, judged=(0, 1, 2))
    seen = cloud()
    one = frame((0, 0, np.nan), seen._replace(cov=np.array([[2.0, 0.3], [0.3, 0.0]])), scene, u=2.0)
    np.testing.assert_allclose(one.mean, matrix @ seen.mean + 2 * shift[:, 0])
    np.testing.assert_allclose(one.cov, matrix @ np.array([[2.0, 0.3], [0.3, 0.0]]) @ matrix.T, atol=1e-9)
    np.testing.assert_allclose(back(one, (0, 2))[1], (matrix @ seen.points + 2 * shift)[[0, 2]], atol=1e-3)


def test_time_is_a_coordinate_too():
    header, points, _ = back(frame((0, 9, np.nan), cloud(), scene_of(("a", "b"))), (-1, 1))
    assert header["mean"] == [9, 1] and header["cov"] == [0, 0, 1] and (points[0] == 9).all()
    assert back(frame((0, 9, 2.5), cloud(), PLANE), (-1, 1))[0]["low"] == [2.5, pytest.approx(cloud().points[1].min())]


def test_errors_go_the_short_way_round():
    truth = np.array([[0.0, -3.1]])
    scene = scene_of(("a", "turn"), truth, (1,))
    one = frame((0, 0, np.nan), Seen(np.array([0.0, 3.1]), np.eye(2)), scene)
    assert error_of(one, scene) == pytest.approx(2 * np.pi - 6.2)
    assert np.isnan(error_of(frame((0, 5, np.nan), cloud(), scene), scene))
    told = row(one, scene, (1e-3, 50.0, -2.0, True))
    assert told[:6].tolist() == pytest.approx([0, np.nan, 1e-3, 50, -2, 1], nan_ok=True) and told.size == 7 + 6


def test_scenes_that_do_not_fit_are_refused():
    with pytest.raises(MotesError, match="scene names: expected at least one coordinate"):
        Scene(names=())
    with pytest.raises(MotesError, match=r"scene truth: expected \(steps, 2\), as there are names, got shape \(3,\)"):
        Scene(names=("a", "b"), truth=np.zeros(3))


def test_the_past_is_bounded_and_thinned_from_its_beginning():
    reel = Reel(200_000)
    one = frame((0, 0, np.nan), cloud(100), PLANE)
    for number in range(2_000):
        reel.add(one._replace(number=number), float(number))
        assert len(reel) * one.size <= 200_000
    first, last, count = reel.reach
    numbers = [reel.near(last, -place).number for place in range(count)]
    assert (first, last) == (0, 1_999) and numbers == sorted(set(numbers), reverse=True)
    # what is new is there step by step, what is old further apart
    assert numbers[:20] == list(range(1_999, 1_979, -1)) and numbers[-2] - numbers[-1] > 50
    assert reel.near(10**9).number == 1_999 and reel.near(-5).number == 0 and reel.near(0, -3).number == 0
    chosen = [one.number for one in reel.chosen(5)]
    assert len(chosen) == 5 and chosen[0] == 0 and chosen[-1] == 1_999


def test_the_past_does_not_go_back_for_ever():
    reel = Reel(1 << 30, seconds=10)
    one = frame((0, 0, np.nan), cloud(10), PLANE)
    assert reel.near(0) is None and reel.reach == (0, 0, 0) and reel.chosen(3) == []
    for number in range(100):
        reel.add(one._replace(number=number), 0.5 * number)
    assert reel.reach == (79, 99, 21)
