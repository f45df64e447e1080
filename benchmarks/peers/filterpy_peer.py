"""filterpy: NumPy, float64; Kalman filter only (for particles it has resampling functions, no filter)."""

import numpy as np
from filterpy.kalman import KalmanFilter
from problems import TRACK

from peers import Unavailable


def prepare(task):
    if task["kind"] != "kalman":
        raise Unavailable("has resampling functions, no particle filter")

    def job(seed):
        filter = KalmanFilter(dim_x=4, dim_z=2)
        filter.x, filter.P, filter.F, filter.H = TRACK["mean"].copy(), np.diag(TRACK["P"]), TRACK["A"], TRACK["H"]
        filter.Q, filter.R = np.diag(TRACK["Q"]), np.diag(TRACK["R"])
        total = 0.0
        for t, y in enumerate(np.asarray(task["ys"])):
            if t:
                filter.predict()
            filter.update(y)
            total += filter.log_likelihood
        return float(total)

    return job
