"""How far two clouds lie apart: in areas, with a level of detection, as files and colours.

`tmchho.evaluate` and `tmchho.m3c2` are the doors; this package holds what they are made of.
"""

from tmchho.evaluation.area_files import read_areas
from tmchho.evaluation.areas import Area, automatic_areas, measure_areas
from tmchho.evaluation.change import Change, m3c2
from tmchho.evaluation.distances import Evaluation, evaluate
from tmchho.evaluation.record import distance_entries
from tmchho.evaluation.tally import AreaStatistics

__all__ = [
    "Area",
    "AreaStatistics",
    "Change",
    "Evaluation",
    "automatic_areas",
    "distance_entries",
    "evaluate",
    "m3c2",
    "measure_areas",
    "read_areas",
]
