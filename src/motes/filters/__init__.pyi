from . import keep as keep
from .explain import Explanation as Explanation
from .info import Info as Info
from .interface import TwoStageFilter as TwoStageFilter
from .look_ahead import LookAheadFilter as LookAheadFilter
from .parallel import run_in_parallel as run_in_parallel
