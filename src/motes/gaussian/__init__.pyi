from .rule import Linearized as Linearized
from .rule import Rule as Rule
from .sigma_points import Cubature as Cubature
from .sigma_points import GaussHermite as GaussHermite
from .sigma_points import SigmaPoints as SigmaPoints
from .sigma_points import Unscented as Unscented
from .taylor import Linear as Linear
from .taylor import Taylor as Taylor
