from .rasters import read_raster as read_raster
from .result_table import Table as Table
from .tables import read_table as read_table
from .tabular import filled as filled
