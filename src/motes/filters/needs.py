"""What filters ask of a model: it is brought into the form asked for, or refused in one line that says what is missing."""

from typing import Any

from motes.core import checks
from motes.core.record import replace
from motes.laws.cluttered import Cluttered
from motes.laws.conditional import AdditiveNoise, Conditional
from motes.laws.custom import Custom
from motes.laws.independent import Together
from motes.laws.several_targets import SeveralTargets
from motes.models import jump_markov
from motes.models.interface import Model
from motes.models.jump_markov import JumpMarkovModel
from motes.models.state_space import StateSpaceModel, as_state_space
from motes.models.structure import structure


def as_particle_model(asked_by: str, model: Any, transition_density: bool) -> StateSpaceModel:
    """Return a state-space model whose dynamics can be drawn from, and whose sensor has a density.

    Args:
        asked_by: the filter, for the message.
        model: state-space or mixed linear model.
        transition_density: whether the dynamics must have a density too.

    Raises:
        MotesError: one is missing, or the value is no model.
    """
    model = as_state_space(asked_by, model)
    dynamics, sensor = model.dynamics, model.sensor
    ask_density(f"{asked_by} sensor", sensor, " (weights are likelihoods)")
    if isinstance(dynamics, Custom) and dynamics.sampler is None:
        checks.refuse(f"{asked_by} dynamics", "a sample function (particles are moved by it)", "Custom with log_prob only")
    if transition_density:
        ask_density(f"{asked_by} dynamics", dynamics, " (a proposal's weights need it)")
    return model


def ask_density(argument: str, part: Conditional, why: str = "", hint: str = "") -> None:
    """Refuse a conditional without a density.

    Args:
        argument: who asks, and for which part of the model.
        part: the conditional.
        why: reason, for the message.
        hint: what to do instead.
    """
    if isinstance(part, Custom) and part.density is None:
        checks.refuse(argument, f"a log_prob{why}", "Custom with sample only", hint)


def as_linear_model(asked_by: str, model: Any, u: Any) -> StateSpaceModel:
    """Return a state-space model that is linear in every state, with Gaussian noises and initial law.

    Raises:
        MotesError: it is not; the message names a state and the reason.
    """
    model = as_state_space(asked_by, model)
    found = structure(model, u)
    if len(found.linear) < model.size:
        name, reason = found.reasons[0]
        checks.refuse(f"{asked_by} model", "a linear-Gaussian model", f"{name}: {reason}", "Use ExtendedKalmanFilter or a particle filter.")
    return model


def as_moment_model(asked_by: str, model: Any, parts: tuple[str, ...] = ("dynamics", "sensor")) -> StateSpaceModel:
    """Return a state-space model whose dynamics and sensor, or those parts that are named, have a mean function and a noise covariance.

    Raises:
        MotesError: one of them has not, or the value is no model.
    """
    model = as_state_space(asked_by, model)
    _check_moments(asked_by, model, parts)
    return model


def as_jump_markov(asked_by: str, model: Any) -> JumpMarkovModel:
    """Return a jump-Markov model whose modes have means and noise covariances; any other model is one with a single mode.

    Raises:
        MotesError: a mode has none, or the value is no model.
    """
    found = jump_markov.as_jump_markov(checks.instance(f"{asked_by} model", model, Model, "a model such as JumpMarkovModel"))
    for part in found.models:
        for one in of_one_plot(part):
            _check_moments(asked_by, one)
    return found


def of_one_plot(model: StateSpaceModel) -> list[StateSpaceModel]:
    """Return the models of which a Gaussian filter asks moments: of each of several sensors, and of one plot where it measures sets."""
    sensors = model.sensor.parts if isinstance(model.sensor, Together) else (model.sensor,)
    of_plots = [each for part in sensors for each in (part.of_each() if isinstance(part, SeveralTargets) else [part])]
    return [replace(model, sensor=part.sensor if isinstance(part, Cluttered) else part) for part in of_plots]


def _check_moments(asked_by: str, model: StateSpaceModel, parts: tuple[str, ...] = ("dynamics", "sensor")) -> None:
    for name in parts:
        part = getattr(model, name)
        if not part.has_moments:
            hint = "Use AdditiveGaussian or AdditiveNoise, or a ParticleFilter."
            given = type(part).__name__ + (" with a law of sample and log_prob alone" if isinstance(part, AdditiveNoise) else "")
            checks.refuse(f"{asked_by} {name}", "a mean function and a noise covariance", given, hint)
