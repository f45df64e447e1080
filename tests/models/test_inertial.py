"""Inertial navigation: error growth against the mechanization itself, discretization against fine steps, the Schuler swing."""

from functools import lru_cache

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from motes.core.checks import MotesError
from motes.models import inertial, mechanization
from motes.models.inertial import Grade
from tiers import each

LATITUDE, LONGITUDE, HEIGHT = np.radians(36.5), np.radians(-84.2), 1500.0
STEP = 0.25


@lru_cache
def flight(seconds, speed=250.0):
    """A flight that weaves, climbs and changes its speed."""
    t = np.arange(0, seconds, STEP)
    heading = np.radians(45) + 0.3 * np.sin(t / 20)
    climb = 5 * np.sin(t / 15)
    pace = speed + 10 * np.cos(t / 11)
    velocity = np.stack([pace * np.cos(heading), pace * np.sin(heading), -climb], axis=1)
    attitude = mechanization.attitude_of(0.2 * np.sin(t / 9), climb / speed, heading)
    return mechanization.moved((LATITUDE, LONGITUDE, HEIGHT), velocity, attitude, STEP)


@lru_cache
def growth(seconds):
    """Transition matrix of the errors over the whole flight."""
    true, total = flight(seconds), np.eye(15)
    for k, force in enumerate(mechanization.readings(true, STEP).force):
        F = inertial.error_growth(true.latitude[k], true.height[k], true.velocity[k], true.attitude[k] @ force, true.attitude[k])
        total = expm(F * STEP) @ total
    return total


def first(motion):
    return mechanization.Motion(*(part[:1] for part in motion))


def test_readings_lead_back():
    true = flight(30)
    back = mechanization.mechanized(first(true), mechanization.readings(true, STEP), STEP)
    assert np.abs(back.velocity - true.velocity).max() < 1e-8
    assert np.abs(back.attitude - true.attitude).max() < 1e-11
    assert np.abs(back.latitude - true.latitude).max() * 6.4e6 < 1e-6


def test_ideal_sensors_of_a_resting_body():
    level = mechanization.moved((LATITUDE, LONGITUDE, HEIGHT), np.zeros((3, 3)), np.tile(np.eye(3), (3, 1, 1)), STEP)
    read = mechanization.readings(level, STEP)
    assert np.allclose(read.force, [0, 0, -inertial.gravity(LATITUDE, HEIGHT)], atol=1e-9)
    assert np.allclose(read.rate, inertial.earth_rate(LATITUDE), atol=1e-12)


@pytest.mark.parametrize("at", each(range(15), set(map(str, range(15))) - {"9", "12"}))
def test_errors_grow_as_the_model_says(at):
    """A small error in each state, put into the mechanization of a weaving flight, against the transition matrices of its steps."""
    true = flight(200)
    read = mechanization.readings(true, STEP)
    sizes = np.repeat([2e-5, 0.01, 2.0, 2e-4, 2e-7], 3)
    error = np.zeros(15)
    error[at] = sizes[at]
    # x is added to the inertial value to get the true one
    meridian, across = inertial.radii(LATITUDE)
    start = first(true)
    place = mechanization.Motion(
        start.latitude - error[6] / (meridian + HEIGHT), start.longitude - error[7] / ((across + HEIGHT) * np.cos(LATITUDE)),
        start.height + error[8], start.velocity - error[3:6], start.attitude)
    carried = mechanization._axes(place)[0] @ mechanization._axes(start)[0].T
    attitude = Rotation.from_rotvec(error[:3]).as_matrix() @ carried @ start.attitude[0]
    place = place._replace(attitude=attitude[None], velocity=(carried @ start.velocity[0] - error[3:6])[None])
    wrong = mechanization.Readings(read.rate - error[12:], read.force - error[9:12])
    found = mechanization.errors(true, mechanization.mechanized(place, wrong, STEP))
    assert np.abs(found[0] - error[:9]).max() < 1e-3 * sizes[at]
    x = growth(200) @ error
    scale = np.abs(x[:9]).reshape(3, 3).max(axis=1).repeat(3)
    floor = np.repeat([1e-9, 1e-6, 1e-5], 3)
    tolerance = 0.02 if at in (2, 14) else 0.006  # what a heading error does, weaker than the rest, feels the length of the steps
    assert (np.abs(found[-1] - x[:9]) < tolerance * scale + floor).all(), (found[-1], x[:9])


def test_discretization_against_fine_steps():
    rng = np.random.default_rng(1)
    attitude = Rotation.from_euler("ZYX", [0.8, 0.1, -0.2]).as_matrix()
    F = inertial.error_growth(LATITUDE, HEIGHT, np.array([170.0, 180.0, -3.0]), np.array([1.0, -2.0, -9.7]), attitude, 3600.0)
    noise = inertial.error_noise(Grade(1e-6, 1e-5, 1e-2, 1e-3, 1e-8, 1e-5), position=0.5)
    noise = noise + 1e-3 * np.outer(*[np.sqrt(np.diag(noise)) * rng.standard_normal(15)] * 2)
    step = 0.3
    transition, covariance = inertial.discretized(F, noise, step)
    pieces = 20_000
    fine = step / pieces
    # fourth-order integration of both differential equations
    def slope(phi, cov):
        return F @ phi, F @ cov + cov @ F.T + noise

    phi, cov = np.eye(15), np.zeros((15, 15))
    for _ in range(pieces // 100):
        h = 100 * fine
        a = slope(phi, cov)
        b = slope(phi + h / 2 * a[0], cov + h / 2 * a[1])
        c = slope(phi + h / 2 * b[0], cov + h / 2 * b[1])
        d = slope(phi + h * c[0], cov + h * c[1])
        phi, cov = (m + h / 6 * (p + 2 * q + 2 * r + s) for m, p, q, r, s in zip((phi, cov), a, b, c, d, strict=True))
    scale = np.sqrt(np.outer(np.diag(cov), np.diag(cov)))
    assert (np.abs(transition - phi) <= 1e-6 * np.abs(phi) + 1e-15).all()
    assert (np.abs(covariance - cov) <= 1e-6 * scale).all()
    assert np.linalg.eigvalsh(covariance / scale).min() > -1e-12


def test_a_resting_system_swings_with_the_schuler_period():
    """At the equator, where the Earth's rotation does not turn the plane of the swing."""
    step, count = 4.0, 2_800  # three hours; later the vertical channel, which is unstable, takes over
    rest = mechanization.moved((0.0, 0.0, 0.0), np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1)), step)
    tilted = first(rest)._replace(attitude=Rotation.from_euler("Y", 1e-4).as_matrix()[None])
    found = mechanization.mechanized(tilted, mechanization.readings(rest, step), step)
    north = found.velocity[:, 0]
    rising = np.flatnonzero((north[:-1] < 0) & (north[1:] >= 0))
    period = np.diff(rising).mean() * step / 60
    assert len(rising) == 2 and abs(period / 84.4 - 1) < 0.01


def test_grades_and_refusals():
    assert inertial.NAVIGATION.gyro_bias < inertial.TACTICAL.gyro_bias < inertial.CONSUMER.gyro_bias
    assert np.isclose(inertial.TACTICAL.gyro_bias, 4.848e-6, rtol=1e-3)
    with pytest.raises(MotesError, match="Grade gyro_bias: expected a standard deviation of at least 0, got -1"):
        Grade(-1.0, 0.0, 0.0, 0.0)
    with pytest.raises(MotesError, match="attitude: expected shape"):
        mechanization.moved((0.0, 0.0, 0.0), np.zeros((4, 3)), np.eye(3)[None], 0.1)


def test_disturbed_sensors():
    ideal = mechanization.Readings(np.zeros((20_000, 3)), np.zeros((20_000, 3)))
    grade = Grade(1e-6, 2e-5, 1e-2, 1e-3)
    read, biases = mechanization.disturbed(3, ideal, grade, STEP)
    assert np.allclose(read.force.mean(axis=0), -biases[0, :3], atol=6 * 1e-3 / np.sqrt(STEP * 20_000))
    assert np.allclose(read.rate.std(axis=0), 2e-5 / np.sqrt(STEP), rtol=0.04)
