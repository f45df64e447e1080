from .result import StudyResult as StudyResult
from .search import Particles as Particles
from .search import particles_for_rmse as particles_for_rmse
from .search import particles_for_time as particles_for_time
