"""SIFT features of photos, by COLMAP."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from malus import _core
from malus.photogrammetry import database, memory
from malus.photogrammetry.bench import Bench

#: Bytes per pixel and thread, measured on photos of 1 and 7 megapixels: COLMAP's SIFT works on a photo at twice its size, in
#: some 18 images of floats.
_SIFT_BYTES_A_PIXEL = 300
#: Share of the available memory that the search for features may take.
_MEMORY_SHARE = 0.7
#: SIFT's octaves: of the photo at twice its size, where a search spends four fifths of its time, and of the photo as it is.
_DOUBLED, _ORIGINAL = -1, 0


def sift_mb(sizes: Sequence[tuple[int, int]], max_side_px: int, first_octave: int = _DOUBLED) -> float:
    """Memory (MB) that a thread takes to find the features of the largest image."""
    pixels = max(width * height * min(1.0, max_side_px / max(width, height)) ** 2 for width, height in sizes)
    return 1e-6 * _SIFT_BYTES_A_PIXEL * pixels / 4.0 ** (first_octave - _DOUBLED)


def find_features(bench: Bench, stage: str, target: Path, names: Sequence[str], reader: dict[str, object]) -> None:
    """Find the features of images that share one camera, which `reader` (ImageReader.*) describes.

    Of an image with more features than photos.max_features COLMAP keeps the largest: whole levels of scale, with that number of
    places at least, and often half as many features more (see `database.keep_features`). So an image that has enough without its
    doubled octave would lose that octave's features anyway, and is not searched at twice its size. The first image tells whether
    it is worth trying on the others.
    """
    first, others = names[:1], names[1:]
    _search(bench, stage, target, first, reader, _ORIGINAL)
    # The others share its camera.
    reader = {"existing_camera_id": database.camera_of(target, first[0]), **reader}
    lacking, part = list(names), (0.0, 1.0)
    if not _lacking(bench, target, first):
        _search(bench, stage, target, others, reader, _ORIGINAL, (0.0, 0.8))
        lacking, part = _lacking(bench, target, others), (0.8, 1.0)
    database.remove_features(target, lacking)  # COLMAP leaves out images that have features.
    _search(bench, stage, target, lacking, reader, _DOUBLED, part)


def _lacking(bench: Bench, target: Path, names: Sequence[str]) -> list[str]:
    """The images with no more features than photos.max_features, so that COLMAP dropped none of them."""
    return [name for name in names if database.place_count(target, name) <= bench.options.photos.max_features]


def _search(
    bench: Bench,
    stage: str,
    target: Path,
    names: Sequence[str],
    reader: dict[str, object],
    first_octave: int,
    part: tuple[float, float] = (0.0, 1.0),
) -> None:
    if not names:
        return
    names_file = bench.folder / f"{stage}_names.txt"
    names_file.write_text("".join(f"{database.quoted(name)}\n" for name in names), encoding="utf-8")
    photos = bench.options.photos
    sizes = [_core.image_size(str(bench.images / database.quoted(name))) for name in names]
    bench.colmap.run(
        "feature_extractor",
        {
            "database_path": target,
            "image_path": bench.images,
            "image_list_path": names_file,
            "ImageReader.single_camera": 1,
            **{f"ImageReader.{key}": value for key, value in reader.items()},
            "SiftExtraction.use_gpu": 0,
            "SiftExtraction.num_threads": _threads(bench, sift_mb(sizes, photos.max_side_px, first_octave)),
            "SiftExtraction.max_num_features": photos.max_features,
            "SiftExtraction.max_image_size": photos.max_side_px,
            "SiftExtraction.first_octave": first_octave,
        },
        bench.log_file(stage),
        on_line=bench.counter(stage, r"Processed file \[(\d+)/(\d+)\]", "features of photo", part),
    )


def _threads(bench: Bench, each_mb: float) -> int:
    """As many threads as there is memory for, if each takes `each_mb`."""
    left = memory.available_mb()
    if each_mb > _MEMORY_SHARE * left:
        bench.log(
            "warning",
            f"finding features takes {each_mb:.0f} MB of memory, of which {left:.0f} MB are left; a smaller "
            "photos.max_side_px takes less",
        )
    return min(bench.colmap.threads, max(1, int(_MEMORY_SHARE * left / each_mb)))
