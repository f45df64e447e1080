from .at_truth import kalman_at_truth as kalman_at_truth
from .bound import Bound as Bound
from .cramer_rao import posterior_cramer_rao as posterior_cramer_rao
