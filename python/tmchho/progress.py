"""Progress as data: what a long call tells while it runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tmchho.arguments import checked_callable
from tmchho.errors import StoppedError


@dataclass(frozen=True)
class ProgressEvent:
    """Something that happened during a registration.

    Parameters
    ----------
    stage : str
        ``outliers``, ``voxel``, ``keypoints``, ``coarse``, ``icp``, ``verdict`` or ``evaluate``.
    done, total : int
        Steps done, and steps in all as far as known now; both 0 when the stage begins.
    best : float or None
        Best score so far, where the stage has one: in ``coarse`` higher is better in robust mode, and lower
        (an RMS distance) in paper mode; in ``icp`` the RMS distance.
    started : bool
        Whether the stage has just begun.
    """

    stage: str
    done: int
    total: int
    best: float | None
    started: bool


ProgressCallback = Callable[[ProgressEvent], object]
"""Gets every event on the thread that made the call; answers True to stop."""


def says_stop(answer: object) -> bool:
    """Return whether a callback's answer is True itself; other true values do not stop anything."""
    return isinstance(answer, (bool, np.bool_)) and bool(answer)


def listener(callback: ProgressCallback | None) -> Callable[..., None] | None:
    """Return the callback in the form in which Rust calls it."""
    checked_callable("progress", callback)
    if callback is None:
        return None

    def tell(*event: Any) -> None:
        if says_stop(callback(ProgressEvent(*event))):
            raise StoppedError("stopped by the progress callback")

    return tell
