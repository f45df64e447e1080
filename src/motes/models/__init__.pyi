from . import terrain as terrain
