"""A rockfill-dam construction site made by code, and surveyed as two different sensors would.

`make_site` shapes the scene, `survey_scanner` and `survey_photogrammetry` survey it, and `make_pair`
does all of this and moves one of the clouds by a known pose: a test of registration in which the
truth is known. `lower_ground` and `move_machine` change a site between two surveys. Everything follows
from the arguments and a seed.
"""

from tmchho.simulate.change import lower_ground, move_machine
from tmchho.simulate.ground import Area, Ground
from tmchho.simulate.materials import Material
from tmchho.simulate.network import SimulatedNetwork, make_network
from tmchho.simulate.pair import SimulatedPair, make_pair, random_pose
from tmchho.simulate.photogrammetry import survey_photogrammetry
from tmchho.simulate.scanner import survey_scanner
from tmchho.simulate.site import Site, make_site
from tmchho.simulate.solids import Solid
from tmchho.simulate.stations import place_stations

__all__ = [
    "Area",
    "Ground",
    "Material",
    "SimulatedNetwork",
    "SimulatedPair",
    "Site",
    "Solid",
    "lower_ground",
    "make_network",
    "make_pair",
    "make_site",
    "move_machine",
    "place_stations",
    "random_pose",
    "survey_photogrammetry",
    "survey_scanner",
]
