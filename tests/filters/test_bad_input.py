"""Every refusal is one line that names the argument, what was expected, what was given, and what to do."""

import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo

pytestmark = pytest.mark.jax

EYE = np.eye(2)


def good_model(**changes):
    parts = {
        "initial": mo.Gaussian([0.0, 1.0], EYE),
        "dynamics": mo.LinearGaussian(0.9 * EYE, 0.1 * EYE),
        "sensor": mo.AdditiveGaussian(lambda x, u, t: x[:1] ** 2, [[0.5]]),
        "names": ("a", "b"),
    }
    return mo.StateSpaceModel(**(parts | changes))


def run_with(filter=None, ys=None, model=None, **rest):
    ys = np.ones((4, 1)) if ys is None else ys
    return mo.run(0, filter or mo.ParticleFilter(n=50), model or good_model(), ys, **rest)


def jump(x, u, t):
    return jnp.stack([x[0] * x[1], x[1]])


def test_the_good_model_runs():
    assert run_with().mean.shape == (4, 2)


CASES = {
    # covariances
    "not symmetric": (lambda: mo.Gaussian([0.0, 0], [[1.0, 0.5], [0.0, 1.0]]), "Gaussian cov: expected a symmetric covariance, got 0.5 at [0, 1]"),
    "not semi-definite": (lambda: mo.Gaussian([0.0, 0], [[1.0, 2.0], [2.0, 1.0]]), "Gaussian cov: expected a positive semi-definite covariance"),
    "negative variance": (lambda: mo.LinearGaussian(EYE, np.diag([1.0, -0.1])), "LinearGaussian Q: expected a positive semi-definite"),
    "infinite covariance": (lambda: mo.Gaussian([0.0], [[np.inf]]), "Gaussian cov: expected finite numbers in the covariance"),
    "cov of another size": (lambda: mo.Gaussian([0.0, 0], [[1.0]]), "Gaussian cov: expected shape (2, 2) (a covariance matrix), got shape (1, 1)"),
    "variances for a covariance": (lambda: mo.Gaussian([0.0, 0], [1.0, 1]), "Gaussian cov: expected shape (2, 2) (a covariance matrix), got shape (2,)"),
    "mean not finite": (lambda: mo.Gaussian([np.nan], [[1.0]]), "Gaussian mean: expected finite numbers, got nan at index [0]"),
    "text for numbers": (lambda: mo.Gaussian(["a"], [[1.0]]), "Gaussian mean: expected an array of numbers"),
    "rows of A": (lambda: mo.LinearGaussian(np.ones((3, 2)), EYE), "LinearGaussian Q: expected shape (3, 3) (rows of A), got shape (2, 2)"),
    "joint noise covariance": (
        lambda: good_model(sensor=mo.LinearGaussian(EYE, EYE), noise_cross_cov=EYE), "noise_cross_cov (with Q and R as one joint covariance)"),
    # models
    "f not a function": (lambda: mo.AdditiveGaussian(3, EYE), "AdditiveGaussian f: expected a function f(x, u, t) of one state, got int"),
    "no law": (lambda: mo.AdditiveNoise(lambda x, u, t: x, 0.5), "AdditiveNoise law: expected a law, or an object with sample"),
    "sensor of another kind": (lambda: good_model(sensor=EYE), "StateSpaceModel sensor: expected LinearGaussian, AdditiveGaussian"),
    "names": (lambda: good_model(names=("a", "a")), "StateSpaceModel names: expected 2 different names, one per state, got ['a', 'a']"),
    "f of another size": (
        lambda: run_with(model=good_model(dynamics=mo.AdditiveGaussian(lambda x, u, t: x[:1], [[1.0]]))),
        "dynamics f(x, u, t): expected a vector of shape (2,), got shape (1,)"),
    "Q of another size": (
        lambda: run_with(model=good_model(dynamics=mo.AdditiveGaussian(lambda x, u, t: x, [[1.0]]))),
        "dynamics Q: expected shape (2, 2) (the size of its f), got shape (1, 1)"),
    "angle out of range": (
        lambda: run_with(model=good_model(sensor=mo.AdditiveGaussian(lambda x, u, t: x[:1], [[1.0]], angles=(3,)))),
        "sensor angles: expected indices of the 1 components, got [3]"),
    "custom without functions": (lambda: mo.Custom(), "Custom: expected sample, log_prob or both, got neither"),
    "mixture weights": (lambda: mo.Mixture.of([-1.0, 2.0], [[0.0, 1.0]], [[[1.0, 1.0]]]), "Mixture weights: expected weights >= 0"),
    "steps": (lambda: mo.simulate(0, good_model(), 0), "simulate steps: expected a whole number of at least 1, got 0"),
    "key": (lambda: mo.simulate("seed", good_model(), 3), "key: expected a JAX key or an integer seed, got 'str'"),
    "mode without a model": (lambda: mo.JumpMarkovModel([1.0], [[1.0]], [EYE]), "JumpMarkovModel models: expected a StateSpaceModel for each mode, got ndarray"),
    "no modes": (lambda: mo.JumpMarkovModel([], [], []), "JumpMarkovModel models: expected at least one mode, got none"),
    "rows of transitions": (
        lambda: mo.JumpMarkovModel([0.5, 0.5], [[0.9, 0.1], [0.2, 0.7]], [good_model()] * 2),
        "JumpMarkovModel transition: expected probabilities that sum to one in each row, got [[0.9"),
    "initial modes": (
        lambda: mo.JumpMarkovModel([1.5, -0.5], EYE, [good_model()] * 2), "JumpMarkovModel initial_mode: expected probabilities that sum to one, got [1.5, -0.5]"),
    "transition of another size": (
        lambda: mo.JumpMarkovModel([0.5, 0.5], [[1.0]], [good_model()] * 2), "JumpMarkovModel transition: expected shape (2, 2) (modes, modes), got shape (1, 1)"),
    "modes of other states": (
        lambda: mo.JumpMarkovModel([0.5, 0.5], EYE, [good_model(), good_model(names=("a", "c"))]),
        "JumpMarkovModel models: expected the same states in all modes (a, b), got a, c"),
    "transition function": (
        lambda: run_with(mo.JumpMarkovFilter(n=3), model=mo.JumpMarkovModel([0.5, 0.5], lambda u, t: jnp.ones(2), [good_model()] * 2)),
        "transition(u, t): expected shape (2, 2) (modes, modes), got shape (2,)"),
    "modes that measure differently": (
        lambda: run_with(mo.InteractingMultipleModel(), model=mo.JumpMarkovModel([0.5, 0.5], EYE, [good_model(), good_model(sensor=mo.LinearGaussian(EYE, EYE))])),
        "JumpMarkovModel models: expected the same number of measured components in all modes, got ['1', '2']"),
    "modes for a particle filter": (
        lambda: run_with(model=mo.JumpMarkovModel([1.0], [[1.0]], [good_model()])),
        "ParticleFilter model: expected a StateSpaceModel or a MixedLinearModel, got JumpMarkovModel. Use InteractingMultipleModel or JumpMarkovFilter, or give model.as_state_space()."),
    "structure of what": (lambda: mo.structure(EYE), "structure model: expected a StateSpaceModel or a MixedLinearModel, got ndarray"),
    # states by name
    "unknown state": (
        lambda: run_with(mo.MarginalizedParticleFilter(n=9, linear=("speed",))), "state: expected one of the names a, b or an index below 2, got 'speed'"),
    "not linear": (
        lambda: run_with(mo.MarginalizedParticleFilter(n=9, linear=("a",))),
        "linear: expected states that are conditionally linear-Gaussian, got a: sensor is nonlinear in it"),
    "not jointly linear": (
        lambda: run_with(mo.MarginalizedParticleFilter(n=9, linear=("a", "b")), model=good_model(
            dynamics=mo.AdditiveGaussian(jump, EYE), sensor=mo.AdditiveGaussian(lambda x, u, t: x[1:], [[1.0]]))),
        "linear: expected states in which the model is jointly linear, got dynamics is not jointly linear in a and b"),
    # filters
    "n": (lambda: mo.ParticleFilter(n=0), "ParticleFilter n: expected a whole number of at least 1, got 0"),
    "n not whole": (lambda: mo.MarginalizedParticleFilter(n=10.5), "MarginalizedParticleFilter n: expected a whole number of at least 1, got 10.5"),
    "n of one without": (lambda: mo.KalmanFilter().with_particles(5), "with_particles filter: expected one with a number of particles n, got KalmanFilter"),
    "proposal": (lambda: mo.ParticleFilter(n=3, proposal=EYE), "ParticleFilter proposal: expected a proposal such as OptimalProposal(), or a conditional such as AdditiveGaussian, got ndarray"),
    "not optimal": (
        lambda: run_with(mo.ParticleFilter(n=3, proposal=mo.OptimalProposal())),
        "ParticleFilter sensor: expected one that is linear-Gaussian in the states (OptimalProposal is exact), got one that is nonlinear in a. Use ExtendedKalmanProposal"),
    "not optimal with angles": (
        lambda: run_with(mo.ParticleFilter(n=3, proposal=mo.OptimalProposal()), model=good_model(sensor=mo.LinearGaussian([[1.0, 0.0]], [[1.0]], angles=(0,)))),
        "got angles among its components (they are wrapped)"),
    "not optimal with noise": (
        lambda: run_with(mo.ParticleFilter(n=3, proposal=mo.OptimalProposal()), model=good_model(sensor=mo.LinearGaussian([[1.0, 0.0]], lambda x, u, t: x[1:, None] ** 2))),
        "got one whose noise covariance depends on b"),
    "proposal without Gaussian steps": (
        lambda: run_with(mo.ParticleFilter(n=3, proposal=mo.UnscentedProposal()), model=good_model(dynamics=mo.AdditiveNoise(lambda x, u, t: x, mo.Laplace([0.5, 0.5])))),
        "ParticleFilter dynamics: expected additive Gaussian noise (UnscentedProposal bends it), got AdditiveNoise. Use no proposal"),
    "proposal without moments": (
        lambda: run_with(mo.AuxiliaryParticleFilter(n=3, proposal=mo.ExtendedKalmanProposal()), model=good_model(sensor=mo.Custom(log_prob=lambda y, x, u, t: 0.0))),
        "AuxiliaryParticleFilter sensor: expected a mean function and a noise covariance (ExtendedKalmanProposal looks at them), got Custom"),
    "nothing to score at": (
        lambda: run_with(mo.AuxiliaryParticleFilter(n=3), model=good_model(dynamics=mo.Custom(sample=lambda key, x, u, t: x))),
        "AuxiliaryParticleFilter dynamics: expected a mean function (particles are scored at it), got Custom. Use a ParticleFilter."),
    "Metropolis steps": (lambda: mo.resampling.MetropolisResampling(steps=0), "MetropolisResampling steps: expected a whole number of at least 1, got 0"),
    "trials": (lambda: mo.resampling.RejectionResampling(trials=2.5), "RejectionResampling trials: expected a whole number of at least 1, got 2.5"),
    "entropy of transport": (lambda: mo.resampling.EntropicTransport(entropy=0.0), "EntropicTransport entropy: expected a number above 0, got 0.0"),
    "transport of scores": (
        lambda: run_with(mo.AuxiliaryParticleFilter(n=9, scheme=mo.resampling.EntropicTransport())),
        "EntropicTransport: expected a filter with a Cloud that does not look ahead by scores, got one with scores. Use Systematic."),
    "transport of Gaussians": (
        lambda: run_with(mo.MarginalizedParticleFilter(n=9, scheme=mo.resampling.EntropicTransport())), "does not look ahead by scores, got MarginalCloud"),
    "transport of costs": (
        lambda: run_with(mo.CostReferenceParticleFilter(n=9, scheme=mo.resampling.EntropicTransport())),
        "EntropicTransport: expected a filter that moves the particles of a Cloud, got one that asks for ancestors."),
    "auxiliary n": (lambda: mo.AuxiliaryParticleFilter(n=0), "AuxiliaryParticleFilter n: expected a whole number of at least 1, got 0"),
    "kernel width": (lambda: mo.KalmanParticleKernelFilter(n=3, width=1.5), "KalmanParticleKernelFilter width: expected a number above 0 and at most 1, got 1.5"),
    "kernel slope": (lambda: mo.KalmanParticleKernelFilter(n=3, slope="ukf"), "KalmanParticleKernelFilter slope: expected one of 'sigma', 'jacobian', got 'ukf'"),
    "kernel state": (lambda: run_with(mo.KalmanParticleKernelFilter(n=3, nonlinear=("z",))), "state: expected one of the names a, b or an index below 2, got 'z'"),
    "kernel noise": (
        lambda: run_with(mo.KalmanParticleKernelFilter(n=3), model=good_model(sensor=mo.AdditiveNoise(lambda x, u, t: x[:1], mo.Laplace([0.5])))),
        "KalmanParticleKernelFilter sensor: expected additive Gaussian noise (kernels are corrected by Kalman filters), got AdditiveNoise"),
    "kernel cap": (lambda: mo.resampling.SplitKernels(cap=0.0), "SplitKernels cap: expected a number above 0 and at most 1, got 0.0"),
    "regularization": (lambda: mo.resampling.Regularization("box"), "Regularization kernel: expected one of 'gaussian', 'epanechnikov', got 'box'"),
    "regularized form": (lambda: mo.RegularizedParticleFilter(n=3, form="both"), "RegularizedParticleFilter form: expected one of 'post', 'pre', 'metropolis'"),
    "shrinking proposals": (
        lambda: mo.RegularizedParticleFilter(n=3, form="metropolis", regularization=mo.resampling.Regularization(shrink=True)),
        "RegularizedParticleFilter regularization: expected no shrinkage with 'metropolis'"),
    "unscented alpha": (lambda: mo.UnscentedKalmanFilter(alpha=0.0), "UnscentedKalmanFilter alpha: expected a number above 0, got 0.0"),
    "unscented kappa": (lambda: run_with(mo.UnscentedKalmanFilter(kappa=-2.0)), "UnscentedKalmanFilter kappa: expected a number above -2 (minus the number of states), got -2.0"),
    "one Hermite point": (lambda: mo.GaussHermiteFilter(degree=1), "GaussHermiteFilter degree: expected at least 2 points per state, got 1"),
    "too many Hermite points": (lambda: run_with(mo.GaussHermiteFilter(degree=400)), "GaussHermiteFilter degree: expected at most 100000 points, got 400^2"),
    "no moments for cubature": (
        lambda: run_with(mo.CubatureKalmanFilter(), model=good_model(sensor=mo.Custom(log_prob=lambda y, x, u, t: 0.0))),
        "CubatureKalmanFilter sensor: expected a mean function and a noise covariance, got Custom"),
    "iterations": (lambda: mo.ExtendedKalmanFilter(iterations=0), "ExtendedKalmanFilter iterations: expected a whole number of at least 1, got 0"),
    "no rule": (lambda: mo.GaussianFilter("cubature"), "GaussianFilter rule: expected a rule such as mo.gaussian.Cubature(), got str"),
    "rule of a bank": (lambda: mo.InteractingMultipleModel(mo.gaussian.Taylor(0)), "InteractingMultipleModel iterations: expected a whole number of at least 1, got 0"),
    "ensemble form": (lambda: mo.EnsembleKalmanFilter(n=3, form="etkf"), "EnsembleKalmanFilter form: expected one of 'deterministic', 'stochastic', got 'etkf'"),
    "inflation": (lambda: mo.EnsembleKalmanFilter(n=3, inflation=-1.0), "EnsembleKalmanFilter inflation: expected a number above 0, got -1.0"),
    "mixands": (lambda: mo.GaussianSumParticleFilter(n=3, mixands=0), "GaussianSumParticleFilter mixands: expected a whole number of at least 1, got 0"),
    "form IV": (lambda: mo.GaussianSumParticleFilter(n=3, mixands=2, form="IV"), "GaussianSumParticleFilter form: expected one of 'I', 'II', 'III', got 'IV'"),
    "noise without components": (
        lambda: run_with(mo.GaussianSumParticleFilter(n=3, mixands=2, form="III"), model=good_model(sensor=mo.AdditiveNoise(lambda x, u, t: x[:1], mo.Laplace([0.5])))),
        "GaussianSumParticleFilter sensor: expected Gaussian noise or a Mixture in form 'III', got Laplace"),
    "cost power": (lambda: mo.CostReferenceParticleFilter(n=3, q=3), "CostReferenceParticleFilter q: expected 1 or 2, got 3"),
    "forgetting": (lambda: mo.CostReferenceParticleFilter(n=3, forgetting=1.5), "CostReferenceParticleFilter forgetting: expected a number from 0 to 1, got 1.5"),
    "scale of zero": (lambda: mo.CostReferenceParticleFilter(n=3, scale=0.0), "CostReferenceParticleFilter scale: expected positive standard deviations, got 0.0"),
    "scales": (lambda: run_with(mo.CostReferenceParticleFilter(n=3, scale=(1.0, 1.0, 1.0))), "CostReferenceParticleFilter scale: expected shape (2,) (one per state)"),
    "jump-Markov n": (lambda: mo.JumpMarkovFilter(n=0), "JumpMarkovFilter n: expected a whole number of at least 1, got 0"),
    "drawn state": (lambda: run_with(mo.JumpMarkovFilter(n=3, sampled="z")), "state: expected one of the names a, b or an index below 2, got 'z'"),
    "modes without moments": (
        lambda: run_with(mo.InteractingMultipleModel(), model=good_model(sensor=mo.Custom(log_prob=lambda y, x, u, t: 0.0))),
        "InteractingMultipleModel sensor: expected a mean function and a noise covariance, got Custom"),
    "modes of no chain": (lambda: run_with(keep=mo.keep.modes), "keep.modes: expected a filter of jump-Markov systems, or a cloud of a joined model, got one whose law is a Cloud, of a model without modes"),
    "modes not kept": (lambda: run_with().mode_probabilities, "got one that kept cov and mean. Run with keep=mo.keep.modes."),
    "delta": (lambda: mo.resampling.InverseExcess(delta=0.0), "InverseExcess delta: expected a number above 0, got 0.0"),
    "grid ends": (lambda: mo.PointMassFilter(1.0, 0.0, 9), "PointMassFilter lower: expected numbers below those of upper"),
    "grid dimensions": (lambda: run_with(mo.PointMassFilter(0.0, 1.0, 9)), "PointMassFilter nodes: expected 2 dimensions (states of the model), got 1"),
    "not linear for Kalman": (lambda: run_with(mo.KalmanFilter()), "KalmanFilter model: expected a linear-Gaussian model, got a: sensor is nonlinear in it"),
    "no moments": (
        lambda: run_with(mo.ExtendedKalmanFilter(), model=good_model(sensor=mo.Custom(log_prob=lambda y, x, u, t: 0.0))),
        "ExtendedKalmanFilter sensor: expected a mean function and a noise covariance"),
    "no density": (
        lambda: run_with(model=good_model(sensor=mo.Custom(sample=lambda key, x, u, t: x))),
        "ParticleFilter sensor: expected a log_prob (weights are likelihoods), got Custom with sample only"),
    "no filter": (lambda: mo.run(0, 5, good_model(), np.ones((3, 1))), "run filter: expected a filter such as ParticleFilter(n=1000), got int"),
    "no model": (lambda: mo.run(0, mo.ParticleFilter(n=5), EYE, np.ones((3, 1))), "run model: expected a StateSpaceModel or a MixedLinearModel"),
    # data
    "infinite measurement": (lambda: run_with(ys=np.array([[1.0], [np.inf]])), "ys: expected finite numbers, or NaN for what was not measured, got inf at index [1, 0]"),
    "one axis": (lambda: run_with(ys=np.ones(5)), "ys: expected shape (t, y) with at least one step, got shape (5,). Write ys[:, None]"),
    "no step": (lambda: run_with(ys=np.ones((0, 1))), "ys: expected shape (t, y) with at least one step, got shape (0, 1)"),
    "other width": (lambda: run_with(ys=np.ones((5, 3))), "ys: expected shape (t, 1), as the sensor measures, got 3 components"),
    "words": (lambda: run_with(ys=np.array([["a"], ["b"]])), "ys: expected real numbers, shape (t, y), got dtype <U1"),
    "inputs too short": (lambda: run_with(inputs={"dt": np.ones(3)}), "inputs: expected arrays with the time axis first, 4 steps as ys"),
    "partly missing": (
        lambda: run_with(ys=np.array([[1.0, 2.0], [np.nan, 1.0]]), model=good_model(sensor=mo.Custom(log_prob=lambda y, x, u, t: -jnp.sum((y - x) ** 2)))),
        "ys: expected rows without NaN, or all NaN (Custom cannot leave out single components), got row 1 partly NaN"),
    "one variance": (
        lambda: mo.LinearGaussian(np.eye(1), 0.5),
        "LinearGaussian Q: expected the covariance matrix of a noise, or a function that returns it, got shape (). One variance is [[v]]"),
    "nothing kept": (lambda: run_with(keep=mo.keep.nothing).mean, "history.mean: expected a run that kept it, got one that kept nothing"),
}


@pytest.mark.parametrize("name", CASES)
def test_refusal(name):
    attempt, message = CASES[name]
    with pytest.raises(mo.MotesError) as error:
        attempt()
    text = str(error.value)
    assert message in text, text
    assert "\n" not in text and len(text) <= 500


def test_missing_extra_says_what_to_install(monkeypatch, tmp_path):
    def without(name):
        raise ModuleNotFoundError(f"No module named '{name}'")

    history, missing = run_with(), mo.MissingExtraError
    monkeypatch.setattr("importlib.import_module", without)
    with pytest.raises(missing, match=r"xarray: needed for this .* pip install 'motes\[results\]'"):
        history.to_xarray()
    with pytest.raises(missing, match=r"pip install 'motes\[results\]'"):
        history.save(tmp_path / "run.nc")
    assert list(tmp_path.iterdir()) == []


def test_stream_refusals(tmp_path):
    stream = mo.stream(0, mo.ParticleFilter(n=20), good_model())
    with pytest.raises(mo.MotesError, match="predict: expected a measurement of step 0 first"):
        stream.predict()
    with pytest.raises(mo.MotesError, match="stream: expected a first measurement"):
        stream.mean  # noqa: B018
    with pytest.raises(mo.MotesError, match="save: expected a stream that has begun"):
        stream.save(tmp_path / "c.npz")
    stream.update([1.0])
    with pytest.raises(mo.MotesError, match="update: expected one measurement per step, got a second one"):
        stream.update([1.0])
    stream.predict()
    with pytest.raises(mo.MotesError, match="y: expected finite numbers, or NaN"):
        stream.update([np.inf])
    with pytest.raises(mo.MotesError, match=r"y: expected shape \(1,\)"):
        stream.update([1.0, 2.0])
