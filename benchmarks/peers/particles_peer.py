"""particles (Chopin): NumPy and numba, float64; collects its own defaults: ESS and log likelihood of each step."""

import warnings

import numpy as np
import particles
from particles import distributions as dists
from particles import kalman
from particles import state_space_models as ssm
from problems import LINE, RADAR, TRACK

from peers import offers

warnings.filterwarnings("ignore")


class Line(ssm.StateSpaceModel):
    def PX0(self):
        return dists.Normal(loc=LINE["mean"], scale=LINE["variance"] ** 0.5)

    def PX(self, t, xp):
        return dists.Normal(loc=LINE["a"] * xp, scale=LINE["q"] ** 0.5)

    def PY(self, t, xp, x):
        return dists.Normal(loc=x, scale=LINE["r"] ** 0.5)


class Radar(ssm.StateSpaceModel):
    def PX0(self):
        return dists.MvNormal(loc=RADAR["mean"], cov=np.diag(RADAR["P"]))

    def PX(self, t, xp):
        return dists.MvNormal(loc=xp @ RADAR["A"].T, cov=np.diag(RADAR["Q"]))

    def PY(self, t, xp, x):
        seen = np.stack([np.hypot(x[:, 0], x[:, 1]), np.arctan2(x[:, 1], x[:, 0])], axis=1)
        return dists.MvNormal(loc=seen, cov=np.diag(RADAR["R"]))


def log_likelihood(smc):
    return smc.logLt


def prepare(task):
    offers(task, ("bootstrap", "many", "kalman"))
    ys = np.asarray(task["ys"])
    if task["kind"] == "kalman":
        linear = kalman.MVLinearGauss(
            F=TRACK["A"], G=TRACK["H"], covX=np.diag(TRACK["Q"]), covY=np.diag(TRACK["R"]), mu0=TRACK["mean"], cov0=np.diag(TRACK["P"])
        )

        def job(seed):
            filter = kalman.Kalman(ssm=linear, data=ys)
            filter.filter()
            return float(np.sum(filter.logpyt))

        return job
    model = ssm.Bootstrap(ssm=Line(), data=ys[:, 0]) if task["model"] == "line" else ssm.Bootstrap(ssm=Radar(), data=ys[:, None, :])
    options = {"fk": model, "N": task["n"], "resampling": "systematic", "ESSrmin": 1.0}

    def job(seed):
        np.random.seed(seed)  # noqa: NPY002 - the library draws from NumPy's global state
        if task["kind"] == "many":
            runs = particles.multiSMC(nruns=task["runs"], nprocs=0, out_func=log_likelihood, **options)
            return float(np.mean([run["output"] for run in runs]))
        smc = particles.SMC(**options)
        smc.run()
        return float(smc.logLt)

    return job
