"""What is in a COLMAP database: features and verified pairs are counted here, because exit codes do not tell."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

#: COLMAP numbers a pair of images a < b as a × this + b.
_PAIR_BASE = 2147483647


def feature_counts(database: Path) -> dict[str, int]:
    """Number of features of every image, by name."""
    with closing(sqlite3.connect(database)) as connection:
        rows = connection.execute(
            "SELECT images.name, COALESCE(keypoints.rows, 0) FROM images LEFT JOIN keypoints USING (image_id)"
        )
        return {str(name): int(count) for name, count in rows}


def camera_of(database: Path, image: str) -> int:
    """Camera number of an image."""
    with closing(sqlite3.connect(database)) as connection:
        row = connection.execute("SELECT camera_id FROM images WHERE name = ?", (image,)).fetchone()
        return int(row[0])


def verified_pairs(database: Path) -> dict[tuple[str, str], int]:
    """Matches that agree with one geometry, by pair of image names; pairs without any are left out."""
    with closing(sqlite3.connect(database)) as connection:
        names = {int(number): str(name) for number, name in connection.execute("SELECT image_id, name FROM images")}
        rows = connection.execute("SELECT pair_id, rows FROM two_view_geometries WHERE rows > 0")
        pairs: dict[tuple[str, str], int] = {}
        for pair, count in rows:
            second = pair % _PAIR_BASE
            first = (pair - second) // _PAIR_BASE
            pairs[names[first], names[second]] = int(count)
        return pairs


def set_camera(database: Path, camera_id: int, params: NDArray[np.float64]) -> None:
    """Replace the assumed parameters (COLMAP's order and pixel convention) of a camera; the model stays."""
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute(
            "UPDATE cameras SET params = ? WHERE camera_id = ?",
            (np.ascontiguousarray(params, "<f8").tobytes(), camera_id),
        )


def connected_groups(names: list[str], pairs: dict[tuple[str, str], int]) -> list[list[str]]:
    """Groups of images that are linked by pairs, the largest first; images without a pair are groups of their own."""
    group = {name: {name} for name in names}
    for first, second in pairs:
        if group[first] is not group[second]:
            group[first] |= group[second]
            for name in group[second]:
                group[name] = group[first]
    distinct = {id(members): members for members in group.values()}
    return sorted((sorted(members) for members in distinct.values()), key=len, reverse=True)
