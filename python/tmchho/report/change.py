"""What `tmchho evaluate --method m3c2` left in the folder of a registration, for its report."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.errors import ReadError
from tmchho.io import read
from tmchho.report.rounding import nice_ceiling
from tmchho.report.scene import Field

EVALUATION, CORES = "evaluation.json", "change.laz"


@dataclass(frozen=True, eq=False)
class StoredChange:
    """M3C2 distances of cores.

    Parameters
    ----------
    xyz : (n, 3) float64 array
        Where they were measured, in the frame of the target.
    distance : (n,) float64 array
        From target to source along the normal; NaN where it could not be measured.
    is_significant : (n,) bool array
        Whether that is more than the level of detection.
    statistics : mapping
        The figures of all cores, as in ``evaluation.json``.
    registration_error : float or None
        What went into the level of detection.
    """

    xyz: NDArray[np.float64]
    distance: NDArray[np.float64]
    is_significant: NDArray[np.bool_]
    statistics: Mapping[str, Any]
    registration_error: float | None

    def field(self, unit: str) -> Field:
        """Return the significant distances; NaN for all others, which are shown in grey."""
        known = np.abs(self.distance[np.isfinite(self.distance)])
        shown = np.abs(self.distance[self.is_significant])
        high = nice_ceiling(float(np.percentile(shown if len(shown) else known, 95)) if len(known) else 1.0)
        values = np.where(self.is_significant, self.distance, np.nan)
        return Field("significant change along the normal", unit, values, -high, high, "diverging")


def load_change(folder: Path, transformation: Any) -> StoredChange | None:
    """Return the change that was measured at a pose, None where none was, or at another pose.

    Parameters
    ----------
    folder : path
        Where ``evaluation.json`` and ``change.laz`` are, if anywhere.
    transformation : (4, 4) nested lists
        The pose of the registration.

    Raises
    ------
    ReadError
        If a file is damaged.
    """
    path = folder / EVALUATION
    if not path.exists() or not (folder / CORES).exists():
        return None
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ReadError(f"{path}: is not JSON ({error}); evaluate once more") from error
    if document.get("method") != "m3c2" or not np.array_equal(document["transformation"], transformation):
        return None
    cores = read(folder / CORES)
    return StoredChange(
        cores.xyz,
        np.asarray(cores.attributes["M3C2_distance"], dtype=np.float64),
        np.asarray(cores.attributes["significant_change"]).astype(bool),
        document["target_to_source"],
        document.get("registration_error"),
    )
