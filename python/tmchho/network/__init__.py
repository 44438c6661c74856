"""Many stations in one frame: pairs are registered, checked by loops, and adjusted together."""

from tmchho.network.results import FineOverlap, LoopClosure, NetworkLink, NetworkRegistration, PlacedStation
from tmchho.network.route import register_network
from tmchho.network.stations import Station, StationControl

__all__ = [
    "FineOverlap",
    "LoopClosure",
    "NetworkLink",
    "NetworkRegistration",
    "PlacedStation",
    "Station",
    "StationControl",
    "register_network",
]
