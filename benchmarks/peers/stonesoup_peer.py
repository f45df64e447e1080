"""Stone Soup: NumPy, float64; predictor, updater and systematic resampler as its tutorial has them."""

from datetime import datetime, timedelta

import numpy as np
from problems import INTERVAL, LINE, RADAR, TRACK
from scipy.special import logsumexp
from scipy.stats import multivariate_normal
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.predictor.particle import ParticlePredictor
from stonesoup.resampler.particle import SystematicResampler
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState, ParticleState
from stonesoup.updater.kalman import KalmanUpdater
from stonesoup.updater.particle import ParticleUpdater

from peers import offers

START = datetime(2000, 1, 1)


class Recorded:
    """Sums the log evidence, which the updater normalizes away; weights are equal here, as every step resamples."""

    evidence = 0.0

    def logpdf(self, *args, **kwargs):
        values = super().logpdf(*args, **kwargs)
        self.evidence += logsumexp(values) - np.log(np.size(values))
        return values


class LineSensor(Recorded, LinearGaussian):
    pass


class RadarSensor(Recorded, CartesianToBearingRange):
    pass


def prepare(task):
    offers(task, ("bootstrap", "kalman"))
    ys = np.asarray(task["ys"])
    return kalman(ys) if task["kind"] == "kalman" else bootstrap(task, ys)


def filtered(predictor, updater, state, ys, before_update):
    """Run predictor and updater over measurements; the first is of the initial state."""
    for t, y in enumerate(ys):
        now = START + timedelta(seconds=INTERVAL * t)
        detection = Detection(StateVector(y), timestamp=now)
        prediction = predictor.predict(state, timestamp=now) if t else state
        before_update(prediction, detection)
        state = updater.update(SingleHypothesis(prediction, detection))


def bootstrap(task, ys):
    if task["model"] == "line":
        mean, P, A, Q = np.array([LINE["mean"]]), [[LINE["variance"]]], np.array([[LINE["a"]]]), np.array([[LINE["q"]]])
        sensor = LineSensor(ndim_state=1, mapping=(0,), noise_covar=np.array([[LINE["r"]]]))
    else:
        mean, P, A, Q = RADAR["mean"], np.diag(RADAR["P"]), RADAR["A"], np.diag(RADAR["Q"])
        sensor, ys = RadarSensor(ndim_state=6, mapping=(0, 1), noise_covar=np.diag(RADAR["R"][::-1])), ys[:, ::-1]
    predictor = ParticlePredictor(LinearGaussianTimeInvariantTransitionModel(transition_matrix=A, covariance_matrix=Q))
    updater = ParticleUpdater(sensor, resampler=SystematicResampler())

    def job(seed):
        np.random.seed(seed)  # noqa: NPY002 - the library draws from NumPy's global state
        points = multivariate_normal.rvs(mean, P, size=task["n"]).reshape(task["n"], -1).T
        state = ParticleState(StateVectors(points), weight=np.full(task["n"], 1 / task["n"]), timestamp=START)
        sensor.evidence = 0.0
        filtered(predictor, updater, state, ys, lambda prediction, detection: None)
        return float(sensor.evidence)

    return job


def kalman(ys):
    dynamics = LinearGaussianTimeInvariantTransitionModel(transition_matrix=TRACK["A"], covariance_matrix=np.diag(TRACK["Q"]))
    predictor = KalmanPredictor(dynamics)
    updater = KalmanUpdater(LinearGaussian(ndim_state=4, mapping=(0, 1), noise_covar=np.diag(TRACK["R"])))

    def job(seed):
        total = []

        def score(prediction, detection):
            expected = updater.predict_measurement(prediction)
            total.append(multivariate_normal.logpdf(np.ravel(detection.state_vector - expected.state_vector), cov=expected.covar))

        filtered(predictor, updater, GaussianState(TRACK["mean"], np.diag(TRACK["P"]), timestamp=START), ys, score)
        return float(np.sum(total))

    return job
