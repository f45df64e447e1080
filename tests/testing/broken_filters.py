"""One broken filter for each rule of the contract, by the name of the function that asks it."""

import jax
import jax.numpy as jnp
from example_filter import TextbookFilter

import motes as mo
from motes.core.checks import is_concrete
from motes.core.record import record, replace

traces = []


def moved(law, by):
    return mo.Gaussian(law.center + by, law.covariance)


@record
class AnyPolicy(TextbookFilter):
    def __post_init__(self):
        pass


@record
class SingleAlone(TextbookFilter):
    def update(self, *args):
        law, info = super().update(*args)
        return replace(law, center=law.center.astype(jnp.float32)), info


@record
class Wide(mo.Gaussian):
    """Draws twice as far from the mean as its covariance says, and inflates half as much as it is told to."""

    def sample(self, key, n):
        return self.center[:, None] + 2 * (super().sample(key, n) - self.center[:, None])

    def inflated(self, factor):
        return Wide(self.center, self.covariance * factor / 2)


@record
class WideLaws(TextbookFilter):
    def init(self, *args):
        law = super().init(*args)
        return Wide(law.center, law.covariance)

    def predict(self, *args):
        law = super().predict(*args)
        return Wide(law.center, law.covariance)

    def correct(self, *args):
        law, info = super().correct(*args)
        return Wide(law.center, law.covariance), info


@record
class OtherStep(TextbookFilter):
    def step(self, *args):
        law, info = super().step(*args)
        return moved(law, 1e-6), info


@record
class NeverIdle(TextbookFilter):
    def update(self, key, model, state, y, u, t):
        law, info = self.correct(key, model, state, y, u, t)
        return moved(law, 1e-3), info


@record
class Remembering(TextbookFilter):
    """Remembers outside of its law how often it was compiled."""

    def predict(self, *args):
        traces.append(1)
        return moved(super().predict(*args), 1e-3 * len(traces))


@record
class Keyed(mo.Gaussian):
    key: jax.Array = None

    def __init__(self, center, covariance, key):
        for name, value in (("center", center), ("covariance", covariance), ("key", key)):
            object.__setattr__(self, name, value)


@record
class KeysInLaws(TextbookFilter):
    """Keeps in its law what no file can hold."""

    def init(self, key, *args):
        law = super().init(key, *args)
        return Keyed(law.center, law.covariance, key)

    def predict(self, key, model, state, u, t):
        law = super().predict(key, model, state, u, t)
        return Keyed(law.center, law.covariance, key)

    def correct(self, key, model, state, y, u, t):
        law, info = super().correct(key, model, state, y, u, t)
        return Keyed(law.center, law.covariance, state.key), info


@record
class MadeAnew(TextbookFilter):
    function: object = None

    def __init__(self, on_collapse="raise", function=None):
        self.__dict__.update(on_collapse=on_collapse, function=lambda x: x)


@jax.custom_batching.custom_vmap
def alone(x):
    return x


@alone.def_vmap
def _together(size, batched, x):
    return x + 1, True


@record
class OnlyAlone(TextbookFilter):
    def predict(self, *args):
        law = super().predict(*args)
        return mo.Gaussian(alone(law.center), law.covariance)


@record
class Looking(TextbookFilter):
    def predict(self, *args):
        law = super().predict(*args)
        return moved(law, 0.1) if is_concrete(law.center) else law


@record
class ZeroForMissing(TextbookFilter):
    def correct(self, key, model, state, y, u, t):
        return super().correct(key, model, state, jnp.where(jnp.all(jnp.isnan(y)), y, jnp.nan_to_num(y)), u, t)


@record
class TooLikely(TextbookFilter):
    def correct(self, *args):
        law, info = super().correct(*args)
        return law, replace(info, log_evidence=info.log_evidence + 0.01)


@record
class Kinked(TextbookFilter):
    def correct(self, key, model, *args):
        law, info = super().correct(key, model, *args)
        return law, replace(info, log_evidence=info.log_evidence + jnp.sqrt(0 * model.sensor.Q[0, 0]))


@record
class Believing(TextbookFilter):
    def update(self, *args):
        law, info = super().update(*args)
        return self.correct(*args)[0], info


@record
class Silent(TextbookFilter):
    def correct(self, *args):
        law, info = super().correct(*args)
        return law, replace(info, collapsed=jnp.zeros((), bool))


@record
class SilentParticles(mo.ParticleFilter):
    def accept(self, *args):
        state, info = super().accept(*args)
        return state, replace(info, collapsed=jnp.zeros((), bool))


@record
class ManyParticles(mo.ParticleFilter):
    def predict(self, *args):
        cloud = super().predict(*args)
        center = cloud.mean()[:, None]
        return replace(cloud, particles=center + jnp.sqrt(self.n / (self.n - jnp.ones(()))) * (cloud.particles - center))


@record
class TwoStates(TextbookFilter):
    def predict(self, *args):
        law = super().predict(*args)
        return mo.Gaussian(law.center.reshape(2), law.covariance)


BROKEN = {
    "value": AnyPolicy(), "form": SingleAlone(), "answers": WideLaws(), "stream": OtherStep(), "unmeasured": NeverIdle(),
    "cut": Remembering(), "checkpoint": KeysInLaws(), "compiled_once": MadeAnew(), "vmapped": OnlyAlone(), "eager": Looking(),
    "missing": ZeroForMissing(), "likelihood": TooLikely(), "derivative": Kinked(), "outlier": Believing(), "collapse": Silent(),
    "inflation": WideLaws(), "weights": SilentParticles(n=30), "fewest": ManyParticles(n=30), "smallest": TwoStates(),
}  # fmt: skip
