"""COLMAP's database, of 3.x and 4.x: counts features and verified pairs, since exit codes do not tell whether there are any; stores matches.

Image names in the database are percent-encoded as in a URL, except for letters, so that spaces do not break COLMAP's lists.
"""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterable, Sequence
from contextlib import closing
from pathlib import Path
from urllib.parse import quote, unquote

import numpy as np
from numpy.typing import NDArray

#: COLMAP numbers a pair of images a < b as a × this + b.
_PAIR_BASE = 2147483647


def quoted(name: str) -> str:
    """The name in COLMAP's files of an image."""
    # Letters of all scripts stay: encoded, each takes up to nine bytes, and the copy's name could exceed the 255 that files may have.
    return "".join(sign if sign.isalnum() else quote(sign, safe="/") for sign in name)


def unquoted(name: str) -> str:
    """The name of an image from its name in COLMAP's files."""
    return unquote(name)


def remove(database: Path) -> None:
    """Remove a database and the log files that COLMAP 4 leaves beside it if it is stopped: a new database must not get the old log."""
    for suffix in ("", "-wal", "-shm"):
        database.with_name(database.name + suffix).unlink(missing_ok=True)


def copy(source: Path, target: Path) -> None:
    """Replace `target` with a copy of a database that no process writes to."""
    remove(target)
    with closing(sqlite3.connect(source)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    shutil.copyfile(source, target)


def feature_counts(database: Path) -> dict[str, int]:
    """Number of features of every image, by name."""
    with closing(sqlite3.connect(database)) as connection:
        rows = connection.execute(
            "SELECT images.name, COALESCE(keypoints.rows, 0) FROM images LEFT JOIN keypoints USING (image_id)"
        )
        return {unquoted(name): int(count) for name, count in rows}


def place_count(database: Path, image: str) -> int:
    """Number of places in an image that have features; a place can have features of several directions."""
    with closing(sqlite3.connect(database)) as connection:
        row = connection.execute(
            "SELECT cols, data FROM keypoints JOIN images USING (image_id) WHERE name = ?", (quoted(image),)
        ).fetchone()
    if row is None:
        return 0
    columns, data = row
    return len(np.unique(np.frombuffer(data or b"", "<f4").reshape(-1, columns)[:, :2], axis=0))


def remove_features(database: Path, images: Iterable[str]) -> None:
    """Remove the features of images, which stay in the database with their cameras."""
    with closing(sqlite3.connect(database)) as connection, connection:
        for table in ("keypoints", "descriptors"):
            connection.executemany(
                f"DELETE FROM {table} WHERE image_id = (SELECT image_id FROM images WHERE name = ?)",
                [(quoted(image),) for image in images],
            )


def camera_of(database: Path, image: str) -> int:
    """Camera number of an image."""
    with closing(sqlite3.connect(database)) as connection:
        row = connection.execute("SELECT camera_id FROM images WHERE name = ?", (quoted(image),)).fetchone()
        return int(row[0])


def _image_names(connection: sqlite3.Connection) -> dict[int, str]:
    rows = connection.execute("SELECT image_id, name FROM images")
    return {int(number): unquoted(name) for number, name in rows}


def read_descriptors(database: Path) -> dict[str, NDArray[np.uint8]]:
    """SIFT descriptors (N×128) of every image, by name."""
    with closing(sqlite3.connect(database)) as connection:
        names = _image_names(connection)
        rows = connection.execute("SELECT image_id, cols, data FROM descriptors")
        found = {names[number]: np.frombuffer(data or b"", np.uint8).reshape(-1, cols) for number, cols, data in rows}
        return {name: found.get(name, np.empty((0, 128), np.uint8)) for name in names.values()}


def keep_features(database: Path, image: str, most: int, mask: NDArray[np.uint8] | None = None) -> None:
    """Keep the largest features of an image, at most `most`, of those inside a mask (H×W of the image's size, non-zero = inside)."""
    with closing(sqlite3.connect(database)) as connection, connection:
        found = connection.execute(
            "SELECT image_id, keypoints.cols, keypoints.data, descriptors.cols, descriptors.data FROM images "
            "JOIN keypoints USING (image_id) JOIN descriptors USING (image_id) WHERE name = ?",
            (quoted(image),),
        ).fetchone()
        if found is None or not found[2]:
            return
        number, columns, points, length, descriptors = found
        keypoints = np.frombuffer(points, "<f4").reshape(-1, columns)
        kept = np.arange(len(keypoints))
        if mask is not None:
            height, width = mask.shape
            # In COLMAP's coordinates the first pixel reaches from 0 to 1.
            u, v = (np.clip(keypoints[:, k].astype(np.int64), 0, side - 1) for k, side in ((0, width), (1, height)))
            kept = np.flatnonzero(mask[v, u])
        if len(kept) > most:
            # After x and y come the four numbers of an affine shape, whose determinant is the square of the scale.
            a, b, c, d = keypoints[kept, 2:6].T
            kept = np.sort(kept[np.argsort(-np.abs(a * d - b * c), kind="stable")[:most]])
        if len(kept) == len(keypoints):
            return
        for table, rows in (
            ("keypoints", keypoints[kept]),
            ("descriptors", np.frombuffer(descriptors, np.uint8).reshape(-1, length)[kept]),
        ):
            connection.execute(
                f"UPDATE {table} SET rows = ?, data = ? WHERE image_id = ?", (len(kept), rows.tobytes(), number)
            )


def write_matches(database: Path, pairs: Sequence[tuple[str, str]], matches: Sequence[NDArray[np.uint32]]) -> None:
    """Store the matches (K×2 indices of features) of pairs of images, for COLMAP to verify."""
    with closing(sqlite3.connect(database)) as connection, connection:
        numbers = {name: number for number, name in _image_names(connection).items()}
        for (first, second), indices in zip(pairs, matches, strict=True):
            a, b = numbers[first], numbers[second]
            ordered = indices if a < b else indices[:, ::-1]
            connection.execute(
                "INSERT INTO matches (pair_id, rows, cols, data) VALUES (?, ?, 2, ?)",
                (min(a, b) * _PAIR_BASE + max(a, b), len(indices), np.ascontiguousarray(ordered, "<u4").tobytes()),
            )


def verified_pairs(database: Path) -> dict[tuple[str, str], int]:
    """Number of matches that agree with one geometry, by pair of image names; pairs without such matches are left out."""
    with closing(sqlite3.connect(database)) as connection:
        names = _image_names(connection)
        rows = connection.execute("SELECT pair_id, rows FROM two_view_geometries WHERE rows > 0")
        ends = ((*divmod(pair, _PAIR_BASE), count) for pair, count in rows)
        return {(names[first], names[second]): int(count) for first, second, count in ends}


def set_camera(database: Path, camera_id: int, params: NDArray[np.float64]) -> None:
    """Replace the assumed parameters (COLMAP's order and pixel convention) of a camera; the model stays."""
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute(
            "UPDATE cameras SET params = ? WHERE camera_id = ?",
            (np.ascontiguousarray(params, "<f8").tobytes(), camera_id),
        )


def connected_groups(names: Iterable[str], pairs: Iterable[tuple[str, str]]) -> list[list[str]]:
    """Groups of images that are linked by pairs, the largest first; images without a pair are groups of their own."""
    group = {name: {name} for name in names}
    for first, second in pairs:
        if group[first] is not group[second]:
            group[first] |= group[second]
            for name in group[second]:
                group[name] = group[first]
    distinct = {id(members): members for members in group.values()}
    return sorted((sorted(members) for members in distinct.values()), key=len, reverse=True)
