from .cusum import cusum as cusum
from .cusum import cusum_step as cusum_step
from .detection import Detection as Detection
from .detection import threshold as threshold
from .shiryaev import shiryaev as shiryaev
from .shiryaev import shiryaev_step as shiryaev_step
