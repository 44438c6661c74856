"""What the site is made of, and how each material looks to a camera and to a laser."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Material(IntEnum):
    """Surface kinds; the value is the row of the tables below."""

    ROCK = 0
    EARTH = 1
    GRASS = 2
    ROCKFILL = 3
    FILL = 4
    ROAD = 5
    GRAVEL = 6
    CONCRETE = 7
    WATER = 8
    BOULDER = 9
    YELLOW_STEEL = 10
    DARK_STEEL = 11
    GLASS = 12
    WALL = 13
    ROOF = 14
    BLUE_STEEL = 15
    RED_STEEL = 16


# Colour in diffuse light (red, green, blue; 0 to 1), one row per material.
COLOURS = np.array(
    [
        (0.50, 0.46, 0.41),
        (0.56, 0.46, 0.34),
        (0.38, 0.43, 0.24),
        (0.58, 0.57, 0.55),
        (0.66, 0.61, 0.52),
        (0.72, 0.65, 0.54),
        (0.68, 0.67, 0.64),
        (0.75, 0.75, 0.73),
        (0.20, 0.32, 0.34),
        (0.52, 0.50, 0.48),
        (0.93, 0.70, 0.10),
        (0.20, 0.20, 0.22),
        (0.25, 0.33, 0.38),
        (0.80, 0.78, 0.68),
        (0.63, 0.25, 0.20),
        (0.18, 0.36, 0.66),
        (0.72, 0.22, 0.16),
    ]
)

# Share of the laser's light that comes back at normal incidence, one value per material.
REFLECTANCE = np.array(
    [0.42, 0.33, 0.50, 0.45, 0.48, 0.50, 0.55, 0.60, 0.02, 0.45, 0.60, 0.12, 0.08, 0.75, 0.40, 0.35, 0.45]
)

# LAS classes: 1 unclassified, 2 ground, 6 building, 9 water, 18 high noise.
LAS_CLASS = np.array([2, 2, 2, 2, 2, 2, 2, 2, 9, 1, 1, 1, 1, 6, 6, 1, 1], dtype=np.uint8)
LAS_CLASS_STRAY = 18
