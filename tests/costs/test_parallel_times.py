"""The sampling period of parallel elements: the paper's model and its inverse, and what is measured of a filter in elements."""

import numpy as np
import pytest

import motes as mo


def test_the_example_of_the_model():
    """Bolic, Djuric, Hong 2005: M = 1 024 particles, L = 50, L_c = 20."""
    assert mo.sampling_period(1_024, elements=4, latency=50, exchange_latency=20) == 582
    assert mo.sampling_period(1_024, elements=1, latency=50, exchange_latency=20) == 2_098
    assert mo.sampling_period(1_024, elements=4, latency=50, exchange_latency=20, clock=1e-8) == pytest.approx(5.82e-6)


@pytest.mark.parametrize("period", [582, 600, 1_000, 2_098, 5_000])
def test_its_inverse_keeps_the_period_with_the_least(period):
    numbers = {"latency": 50, "exchange_latency": 20}
    elements = mo.costs.elements_for_period(period, 1_024, **numbers)
    assert mo.sampling_period(1_024, elements, **numbers) <= period
    assert elements == 1 or mo.sampling_period(1_024, elements - 1, **numbers) > period
    particles = mo.costs.particles_for_period(period, 4, **numbers)
    assert mo.sampling_period(particles, 4, **numbers) <= period < mo.sampling_period(particles + 4, 4, **numbers)


def test_its_inverses_undo_it_in_whatever_unit():
    """A period that is met exactly is met: what is rounded on the way costs no element, and no particle."""
    for particles, elements, latency, waiting, clock in ((4_233, 7, 5, 51, 1.0), (17_208, 6, 51, 27, 0.1), (11_350, 25, 34, 53, 1e-9)):
        numbers = (latency, waiting, clock)
        assert mo.costs.elements_for_period(mo.sampling_period(particles, elements, *numbers), particles, *numbers) == elements
        of_all = particles * elements
        assert mo.costs.particles_for_period(mo.sampling_period(of_all, elements, *numbers), elements, *numbers) == of_all


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: mo.sampling_period(0), "sampling_period particles"),
        (lambda: mo.sampling_period(10, 0), "sampling_period elements"),
        (lambda: mo.sampling_period(10, latency=-1), "sampling_period latency: expected a number of cycles, at least 0"),
        (lambda: mo.sampling_period(10, clock=0), "sampling_period clock"),
        (lambda: mo.sampling_period(10, latency=True), "sampling_period latency"),
        (lambda: mo.costs.elements_for_period("5ms", 1_024), "elements_for_period period: expected a number above 0"),
        (lambda: mo.costs.particles_for_period(np.nan, 4), "particles_for_period period: expected a number above 0"),
        (lambda: mo.costs.particles_for_period(np.inf, 4), "particles_for_period period: expected a number above 0"),
        (lambda: mo.costs.elements_for_period(60, 1_024, 50, 20), "elements_for_period period: expected more than 70"),
        (lambda: mo.costs.particles_for_period(71, 4, 50, 20), "particles_for_period period: expected at least 72"),
        (lambda: mo.fit_step_time(mo.Distributed(mo.ParticleFilter(n=64)), mo.textbook.growth(), np.zeros((4, 1)), elements=(4, 4)),
         "fit_step_time elements: expected different numbers"),
        (lambda: mo.fit_step_time(mo.Distributed(mo.ParticleFilter(n=64)), mo.textbook.growth(), np.zeros((4, 1)), particles=(64, 128),
                                  elements=(3, 4)), "fit_step_time elements: expected divisors of all numbers of particles, got 3 for 64"),
    ],
)  # fmt: skip
def test_what_is_refused(call, message):
    with pytest.raises(mo.MotesError, match=message):
        call()


def test_parts_for_particles_elements_and_bytes_are_found():
    true = mo.costs.StepTime(1e-4, 2e-8, (), 5e-6, 1e-9)
    sizes = [(n / d, k / d, sent) for n in (1e4, 1e5) for k in (8, 16) for d, sent in ((1, 0), (2, n / 8), (4, n / 4))]
    found = mo.costs.StepTime.fitted(tuple((*size, true.seconds(*size)) for size in sizes))
    np.testing.assert_allclose([found.fixed, found.per_particle, found.per_element, found.per_byte], [1e-4, 2e-8, 5e-6, 1e-9], rtol=1e-6)
    assert max(np.abs(found.residuals)) < 1e-6 and abs(found.particles(2e-3, 8) - 93_000) <= 1


def test_bytes_that_are_sent():
    model = mo.textbook.radar_tracking()
    sent = {type(exchange).__name__: mo.Distributed(mo.ParticleFilter(n=2**20), 8, exchange).sent(model, 8)
            for exchange in (mo.Proportional(), mo.Ring(0.1), mo.Butterfly(0.25), mo.Apart())}  # fmt: skip
    assert sent == {"Proportional": 2 * 16 * 1_024 * 28, "Ring": 13_108 * 36, "Butterfly": 32_768 * 36, "Apart": 0}
    assert mo.Distributed(mo.ParticleFilter(n=2**20)).sent(model, 1) == 0


@pytest.mark.night
@pytest.mark.filterwarnings("ignore::motes.core.checks.MotesWarning")
def test_an_unseen_number_of_elements_is_predicted():
    """Within 20 percent, from fits on other numbers."""
    model = mo.textbook.radar_tracking()
    ys = mo.simulate(0, model, 20)[1]
    filter = mo.Distributed(mo.ParticleFilter(n=64_000), on_collapse="predict")
    line = mo.fit_step_time(filter, model, ys, particles=(32_000, 96_000), elements=(2, 16))
    # the least of several: a neighbor on the machine makes times longer, never shorter
    measured = min(mo.costs.seconds_per_step(filter, model, ys) for _ in range(3))
    assert line.seconds(64_000, 8) == pytest.approx(measured, rel=0.2)
