"""Scanner stations: E57 and PTX files hold scans in the scanner's own frame, each with a pose.

Clouds hold the points in the common frame, ``scan_index`` where there are several scans, and under the key
``scans`` of their metadata what is told of each. Whoever moves a cloud moves its stations by `moved_scans`.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.errors import ReadError
from tmchho.io.format import NOTE

logger = logging.getLogger(__name__)

SCAN_INDEX = "scan_index"
ROW, COLUMN = "row_index", "column_index"


@dataclass(frozen=True, eq=False)
class Scan:
    """One station.

    Parameters
    ----------
    name : str
        As in the file, perhaps empty.
    world_from_scan : (4, 4) float64 array
        Pose of the scanner, in the frame of the cloud's coordinates.
    """

    name: str
    world_from_scan: NDArray[np.float64]

    def to_world(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (n, 3) points of the scanner's frame in that of the cloud."""
        return _applied(self.world_from_scan, xyz)

    def from_world(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (n, 3) points of the cloud in the scanner's frame."""
        return _applied(np.asarray(np.linalg.inv(self.world_from_scan)), xyz)


def _applied(matrix: NDArray[np.float64], xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    if np.array_equal(matrix, np.eye(4)):
        return xyz  # so that points which are not finite stay as they are
    return np.asarray(xyz @ matrix[:3, :3].T + matrix[:3, 3])


def joined(parts: Sequence[PointCloud], scans: Sequence[Scan], metadata: dict[str, Any]) -> PointCloud:
    """Return the scans of one file as one cloud.

    Parameters
    ----------
    parts : sequence of PointCloud
        The scans with points, already in the common frame; at least one.
    scans : sequence of Scan
        The station of each.
    metadata : dict
        Of the cloud; the stations are added.

    Returns
    -------
    PointCloud
        With ``scan_index`` if there are several parts; 0 stands for attributes that a scan lacks.
    """
    metadata = {**metadata, "scans": tuple(scans)}
    if len(parts) == 1:
        return replace(parts[0], metadata=metadata)
    name = parts[0].name
    keys = list(dict.fromkeys(key for part in parts for key in part.attributes))
    gaps = [key for key in keys if any(key not in part.attributes for part in parts)]
    if gaps:
        logger.log(NOTE, "%s: not all scans have %s; the others get 0", name, ", ".join(gaps))
    attributes = {key: _joined(key, parts) for key in keys}
    lengths = [len(part) for part in parts]
    attributes[SCAN_INDEX] = np.repeat(np.arange(len(parts), dtype=np.uint16), lengths)
    logger.log(NOTE, "%s: %d scans are joined; scan_index tells them apart", name, len(parts))
    return PointCloud(np.concatenate([part.xyz for part in parts]), attributes, metadata=metadata, name=name)


def _joined(key: str, parts: Sequence[PointCloud]) -> NDArray[Any]:
    given = [part.attributes[key] for part in parts if key in part.attributes]
    dtype = np.result_type(*given)
    return np.concatenate(
        [part.attributes[key] if key in part.attributes else np.zeros(len(part), dtype) for part in parts]
    )


def valid_points(
    xyz: NDArray[np.float64],
    attributes: Mapping[str, NDArray[Any]],
    is_valid: NDArray[np.bool_],
    name: str,
    number: int,
) -> PointCloud:
    """Return one scan without the points that the scanner marked as missing, and say how many there were."""
    n_wrong = len(xyz) - int(np.count_nonzero(is_valid))
    if n_wrong == 0:
        return PointCloud(xyz, attributes, name=name)
    logger.log(
        NOTE, "%s: %d of %d points of scan %d are invalid and left out", name, n_wrong, len(xyz), number + 1
    )
    kept = {key: values[is_valid] for key, values in attributes.items()}
    return PointCloud(xyz[is_valid], kept, name=name)


def check_pose(matrix: NDArray[np.float64], number: int) -> None:
    """Raise if a pose cannot be one: it would move all points of scan `number` to nowhere."""
    turn = matrix[:3, :3]
    if not np.isfinite(matrix).all() or abs(np.linalg.det(turn)) <= 1e-9 * np.abs(turn).max() ** 3:
        raise ReadError(f"has an impossible pose in scan {number + 1}; export it again")


def split(cloud: PointCloud, kept: Mapping[str, Any]) -> Iterator[tuple[Scan, NDArray[np.intp]]]:
    """Give each scan of a cloud with the rows of its points.

    Without ``scan_index`` all points are one scan. Stations that nothing is known of stand at the origin.
    """
    known: Sequence[Scan] = kept.get("scans", ())
    index = cloud.attributes.get(SCAN_INDEX)
    if index is None:
        numbers, rows = [0], [np.arange(len(cloud))]
    else:
        values, inverse = np.unique(index, return_inverse=True)
        numbers, rows = values.tolist(), [np.flatnonzero(inverse == number) for number in range(len(values))]
    for number, own_rows in zip(numbers, rows, strict=True):
        is_known = isinstance(number, int) and 0 <= number < len(known)
        yield (known[number] if is_known else Scan(f"scan {number}", np.eye(4))), own_rows


def moved_scans(metadata: Mapping[str, Any], matrix: NDArray[np.float64]) -> dict[str, Any]:
    """Return metadata whose stations have moved with their points.

    Parameters
    ----------
    metadata : mapping
        Of the cloud before; without stations it comes back as it is.
    matrix : (4, 4) float64 array
        What the points were multiplied by, a scale included; the stations turn and shift and keep theirs.
    """
    scans: Sequence[Scan] = metadata.get("scans", ())
    if not scans:
        return dict(metadata)
    scale = np.cbrt(np.linalg.det(matrix[:3, :3]))
    moved = []
    for scan in scans:
        pose = matrix @ scan.world_from_scan
        pose[:3, :3] /= scale
        moved.append(Scan(scan.name, pose))
    return {**metadata, "scans": tuple(moved)}
