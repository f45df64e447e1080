from .plan import Pilot as Pilot
from .plan import Plan as Plan
