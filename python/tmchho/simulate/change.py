"""What happens on a site between two surveys: ground settles, a machine drives off.

Why: whether a measure of change finds it, and nothing else, can be told only where all change is known.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tmchho.arguments import checked_number
from tmchho.errors import InvalidArgumentError
from tmchho.simulate.ground import Area
from tmchho.simulate.materials import Material
from tmchho.simulate.site import Site
from tmchho.simulate.solids import Solid


def lower_ground(site: Site, area: Area, depth_m: float) -> Site:
    """Return the site with the ground of an area, and what stands on it, lowered.

    Parameters
    ----------
    site : Site
        Before.
    area : Area
        Where; its rim is as steep as the grid allows.
    depth_m : float
        By how much, in metres; negative raises it.

    Returns
    -------
    Site
        After; shares with `site` what did not change.

    Raises
    ------
    InvalidArgumentError
        If the area holds no node of the ground, or the depth is not finite.
    """
    depth_m = checked_number("depth_m", depth_m)
    ground = site.ground
    n_y, n_x = ground.heights.shape
    x: np.ndarray = ground.west + ground.cell_m * np.arange(n_x)
    y: np.ndarray = ground.south + ground.cell_m * np.arange(n_y)
    inside = area.contains(*np.meshgrid(x, y))
    if not inside.any():
        raise InvalidArgumentError(
            f"area {area} holds no ground of the site; give one within {x[0]:g} to {x[-1]:g} m east and "
            f"{y[0]:g} to {y[-1]:g} m north"
        )
    lowered = replace(ground, heights=np.where(inside, ground.heights - depth_m, ground.heights))
    drop = np.array([0.0, 0.0, -depth_m])
    solids = (
        replace(solid, centre=solid.centre + drop) if _stands_in(area, solid) else solid
        for solid in site.solids
    )
    return replace(site, ground=lowered, solids=tuple(solids))


def move_machine(site: Site, area: Area, shift: tuple[float, float]) -> Site:
    """Return the site after everything but boulders in an area has moved together.

    Parameters
    ----------
    site : Site
        Before.
    area : Area
        Where it stands.
    shift : (east, north)
        How far it moves, in metres. It goes up or down as the ground does between the two places.

    Returns
    -------
    Site
        After; shares with `site` what did not change.

    Raises
    ------
    InvalidArgumentError
        If nothing stands in the area.
    """
    east, north = (checked_number("shift", value) for value in shift)
    moving = [solid.material != Material.BOULDER and _stands_in(area, solid) for solid in site.solids]
    if not any(moving):
        raise InvalidArgumentError(
            f"in area {area} stands nothing but boulders; give one where a machine stands"
        )
    middle = np.mean(
        [solid.centre for solid, moves in zip(site.solids, moving, strict=True) if moves], axis=0
    )
    x, y = (np.array([middle[axis], middle[axis] + by]) for axis, by in ((0, east), (1, north)))
    here, there = site.ground.height(x, y)
    step = np.array([east, north, there - here])
    solids = (
        replace(solid, centre=solid.centre + step) if moves else solid
        for solid, moves in zip(site.solids, moving, strict=True)
    )
    return replace(site, solids=tuple(solids))


def _stands_in(area: Area, solid: Solid) -> bool:
    return bool(area.contains(solid.centre[:1], solid.centre[1:2])[0])
