"""Stone Soup's trackers of sets of plots: probabilistic data association (PDA) and its joint form (JPDA), as its tutorials have them."""

from datetime import datetime, timedelta

import numpy as np
from stonesoup.dataassociator.probability import JPDA, PDA
from stonesoup.functions import gm_reduce_single
from stonesoup.hypothesiser.probability import PDAHypothesiser
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.types.angle import Bearing
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.state import GaussianState
from stonesoup.types.track import Track
from stonesoup.types.update import GaussianStateUpdate
from stonesoup.updater.kalman import ExtendedKalmanUpdater, KalmanUpdater

START = datetime(2000, 1, 1)
PLACES, STATES = (0, 2), (0, 2, 1, 3)
"""Where the places stand among its states, which go place, velocity, place, velocity; and all of ours among its own."""


def updated(hypotheses, updater):
    """Return the Gaussian with the moments of what each hypothesis makes of the prediction."""
    states = [updater.update(each) if each else each.prediction for each in hypotheses]
    means, covs = StateVectors([state.state_vector for state in states]), np.stack([state.covar for state in states], axis=2)
    mean, cov = gm_reduce_single(means, covs, np.array([float(each.probability) for each in hypotheses]))
    return GaussianStateUpdate(mean, cov, hypotheses, hypotheses[0].measurement.timestamp)


class Tracker:
    """One of the two on scans of a `World`, the first of which is of the initial state."""

    def __init__(self, world, gate):
        """Build the tracker: JPDA where there are several targets; plots with less than `gate` of the probability inside are left out."""
        motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(world.intensity)] * 2)
        if world.polar:  # its plots are bearing and range
            sensor = CartesianToBearingRange(ndim_state=4, mapping=PLACES, noise_covar=np.diag(world.noise[::-1]))
        else:
            sensor = LinearGaussian(ndim_state=4, mapping=PLACES, noise_covar=np.diag(world.noise))
        self.polar, self.updater = world.polar, (ExtendedKalmanUpdater if world.polar else KalmanUpdater)(sensor)
        hypothesiser = PDAHypothesiser(KalmanPredictor(motion), self.updater, clutter_spatial_density=world.density,
                                       prob_detect=world.detection, prob_gate=gate)  # fmt: skip
        self.associator = (PDA if len(world.starts) == 1 else JPDA)(hypothesiser=hypothesiser)
        order = list(STATES)
        self.tracks = [Track([GaussianState(np.array(mean)[order], np.diag(np.array(variances)[order]), timestamp=START)])
                       for mean, variances in world.starts]  # fmt: skip

    def detections(self, scans):
        """Bring scans into the form that it wants."""

        def one(plot, time):
            found = [[Bearing(plot[1])], [plot[0]]] if self.polar else plot[:, None]
            return Detection(StateVector(found), timestamp=time)

        times = [START + timedelta(seconds=t) for t in range(len(scans))]
        return [(now, {one(plot, now) for plot in scan}) for now, scan in zip(times, scans, strict=True)]

    def run(self, scans):
        """Return the mean place of each target after each scan, `(t, targets, 2)`."""
        means = []
        for now, plots in scans:
            found = self.associator.associate(set(self.tracks), plots, now)
            for track in self.tracks:
                track.append(updated(found[track], self.updater))
            means.append([np.ravel(track.state.state_vector)[list(PLACES)] for track in self.tracks])
        return np.array(means, float)
