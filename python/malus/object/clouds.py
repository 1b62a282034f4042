"""The stations' clouds as oriented points of an object, for places that no station measured."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from malus import _core
from malus.batch import Outcome
from malus.object.agreement import OrientedPoints
from malus.object.cloud_file import read_cloud, without_normals
from malus.object.definition import Object
from malus.object.implicit import pixel_side
from malus.workspace import Workspace


def clouds_of(
    thing: Object, done: Sequence[Outcome], output: Path, gsd: float, threads: int
) -> tuple[list[OrientedPoints], list[str]]:
    """The stations' clouds that have normals, without duplicates and scaled by the known distances, and warnings about the others. Each
    point counts as a pixel that is so large that neighboring points form a surface.
    """
    parts: list[OrientedPoints] = []
    warnings: list[str] = []
    clouds: dict[str, tuple[str, float]] = {}
    for outcome in done:
        said = thing.campaign.station(outcome["file"]).describe()
        if "prior_cloud" in said:
            clouds.setdefault(said["prior_cloud"], (outcome["station"], said["prior_scale"]))
    for cloud, (station, scale) in clouds.items():
        read = read_cloud(Path(cloud), thing.unit)
        noise = Workspace(output / "stations" / station).manifest["steps"]["prior"]["notes"]["noise"]
        if read is None:
            warnings.append(without_normals(cloud, thing.folder))
        else:
            count, points, normals = len(read[0]), scale * read[0], read[1]
            # Limited like the scales of views, because the margins about blocks are no wider.
            (*_, side) = _core.scales_of([gsd, gsd, max(gsd, pixel_side(points, threads))])
            parts.append(
                OrientedPoints(
                    points, normals, np.full(count, float(noise)), np.zeros(count, np.int64),
                    np.full(count, side, np.float32) if side > 1 else None,
                )
            )  # fmt: skip
    return parts, warnings
