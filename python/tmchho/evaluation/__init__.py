"""How far two clouds lie apart: in areas, with a level of detection, as files and colours.

`tmchho.evaluate` is the door; this package holds what it is made of.
"""

from tmchho.evaluation.area_files import read_areas
from tmchho.evaluation.areas import Area, AreaStatistics, automatic_areas, measure_areas
from tmchho.evaluation.distances import Evaluation, evaluate
from tmchho.evaluation.record import distance_entries

__all__ = [
    "Area",
    "AreaStatistics",
    "Evaluation",
    "automatic_areas",
    "distance_entries",
    "evaluate",
    "measure_areas",
    "read_areas",
]
