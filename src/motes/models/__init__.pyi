from . import terrain as terrain
from . import textbook as textbook
