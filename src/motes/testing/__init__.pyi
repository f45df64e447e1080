from .check import check_filter as check_filter
from .verdict import Verdict as Verdict
