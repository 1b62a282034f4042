"""Whether the marks of known distances and control points lie in their photos."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from malus.errors import InputError
from malus.photogrammetry.photos import Photo


def _marks(said: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """All marks in photos, each with the name of its table."""
    for number, bar in enumerate(said["scale"], 1):
        for mark in [*bar["a"], *bar["b"]]:
            yield f"[[scale]] {number}", mark
    for point in said["control"]:
        for mark in point["marks"]:
            yield f"[[control]] {point['name']}", mark


def marks_in_files(said: Mapping[str, Any], photos: Sequence[Photo]) -> dict[str, Any]:
    """`Station.describe` with the marks' photos as the files are named, also where one of both names writes accents apart from their
    letters, as macOS does.
    """
    named = {unicodedata.normalize("NFC", photo.name): photo.name for photo in photos}

    def renamed(mark: Mapping[str, Any]) -> dict[str, Any]:
        return {**mark, "image": named.get(unicodedata.normalize("NFC", mark["image"]), mark["image"])}

    return {
        **said,
        "scale": [{**bar, **{end: [renamed(mark) for mark in bar[end]] for end in "ab"}} for bar in said["scale"]],
        "control": [{**point, "marks": [renamed(mark) for mark in point["marks"]]} for point in said["control"]],
    }


def require_marks_in_photos(said: Mapping[str, Any], photos: Sequence[Photo]) -> None:
    """Check the marks of `Station.describe` before hours go into matching the photos.

    Raises InputError for a mark outside of its photo, as it is measured by programs that turn photos by their EXIF entry.
    """
    of_name = {photo.name: photo for photo in photos}
    for table, mark in _marks(said):
        photo = of_name.get(mark["image"])
        if photo is None:
            continue
        x, y = mark["x"], mark["y"]
        if -0.5 <= x <= photo.width - 0.5 and -0.5 <= y <= photo.height - 0.5:
            continue
        turned = -0.5 <= x <= photo.height - 0.5 and -0.5 <= y <= photo.width - 0.5
        raise InputError(
            f"{said['path']}: {table}: its mark x = {x:g}, y = {y:g} lies outside of {photo.name}, which has "
            f"{photo.width} x {photo.height} pixels"
            + ("; EXIF orientation is ignored: mark the photo as its pixels are stored" if turned else "")
        )
