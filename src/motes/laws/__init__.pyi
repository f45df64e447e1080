from .cloud import Cloud as Cloud
from .conditional import Conditional as Conditional
from .cost_cloud import CostCloud as CostCloud
from .factored import FactoredGaussian as FactoredGaussian
from .grid_cloud import GridCloud as GridCloud
from .law import Law as Law
from .marginal_cloud import MarginalCloud as MarginalCloud
from .mode_mixture import ModeMixture as ModeMixture
