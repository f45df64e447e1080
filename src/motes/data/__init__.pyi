from .sets import DataSet as DataSet
from .sets import coal as coal
from .sets import galaxies as galaxies
from .sets import lynx as lynx
from .sets import nile as nile
from .sets import pound as pound
