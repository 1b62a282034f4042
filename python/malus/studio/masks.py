"""Masks of the object and labels of reflection: read, written, and selected by color."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngImageFile

import malus
from malus import _core
from malus._extra import extra
from malus._files import read_regular, write_bytes
from malus.errors import DataError, InputError
from malus.options import Options
from malus.overlay import nearest_points
from malus.pictures import data_url, encode
from malus.planning import prior_upon_image
from malus.raster import step_for
from malus.studio.pictures import colored, displayed, distorting

#: Long side of the reduced image on which GrabCut runs: it then takes seconds, also for large images.
_CUT_SIDE_PX = 640
_CUT_ITERATIONS = 4
#: Regions smaller than this share of GrabCut's mask are specks: background that looks like the object, or highlights on the
#: object.
_SPECK = 0.01

Bytes = NDArray[np.uint8]


def decode(content: bytes, size: tuple[int, int]) -> Bytes:
    """Pixels H×W of a gray PNG from the page; InputError unless it is a PNG of this width and height."""
    try:
        # Not Image.open, which refuses images of more than 179 megapixels; nothing is decoded before the size is known.
        with PngImageFile(io.BytesIO(content)) as image:
            width, height = image.size
            if image.size == size:
                return np.array(image.convert("RGBA").getchannel("R"))
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(f"the mask is no PNG image ({error})") from None
    raise InputError(f"the mask is {width} x {height} pixels, expected {size[0]} x {size[1]} as the images")


def read(path: Path, kind: str = "mask") -> bytes:
    """A mask (255 or 0, as a run reads it) or a label image (kind "labels", unchanged) as PNG for the page."""
    if kind != "labels":
        try:
            return encode(_core.read_mask(str(path)), "PNG")
        except InputError:
            pass  # Black everywhere, or a photograph: shown as it is, so that it can be painted anew.
    pixels, full_scale = _core.read_image_dn(str(path))
    gray = pixels if pixels.ndim == 2 else pixels.max(axis=2)
    # Labels are small numbers in 8 bits; of more bits, pixels are set or not.
    values = gray if full_scale <= 255 else np.where(gray != 0, 255, 0)
    return encode(values.astype(np.uint8), "PNG")


def write(path: Path, values: Bytes, *, may_replace: bool) -> Path:
    """Write a mask or label image as PNG and return its path: `path`, or a numbered one if another image would be overwritten."""
    content = encode(values, "PNG")
    place, count = path, 1
    while not may_replace and place.exists() and read_regular(place) != content:
        count += 1
        place = path.with_stem(f"{path.stem}_{count}")
    write_bytes(place, content)
    return place


def similar(image: Path, u: int, v: int, tolerance: int) -> bytes:
    """PNG of the pixels connected with (u, v) that look like it, 255 or 0."""
    return encode(_core.select_similar(displayed(image), u, v, tolerance), "PNG")


def cut_out(image: Path, hints: Bytes, threads: int) -> bytes:
    """PNG of the object found by GrabCut from hints (0 background, 1 object, 2 and 3 probably background and object; of the image's size)."""
    picture = displayed(image)
    if hints.shape != picture.shape[:2]:
        raise InputError(f"the hints are {hints.shape[1]} x {hints.shape[0]} pixels, expected the image's size")
    step = step_for(picture.shape, _CUT_SIDE_PX)
    # The middle pixel of each cell: with the first one, the mask would lie half a cell beside the object.
    middles = np.ix_(*(np.minimum(np.arange(step // 2, side + step // 2, step), side - 1) for side in hints.shape))
    found = _core.cut_out_object(picture[middles], hints[middles], _CUT_ITERATIONS, threads)
    cleaned = without_specks(found)
    if not cleaned.any():
        raise DataError(
            "no edge was found by color: what is painted looks like what lies around it. It stays as it is; the brush and the "
            "eraser make a mask without it"
        )
    height, width = hints.shape
    # The box leaves out the part of the last cells that lies beyond the image.
    whole = Image.fromarray(cleaned).resize(
        (width, height), Image.Resampling.BILINEAR, box=(0, 0, width / step, height / step)
    )
    return encode(np.where(np.asarray(whole) >= 128, 255, 0).astype(np.uint8), "PNG")


def without_specks(mask: Bytes) -> Bytes:
    """The mask (255 or 0) without small regions and holes: they get the value of their surroundings."""
    ndimage = extra("scipy.ndimage", "scipy", "finding the edge", "studio")
    cleaned = mask.copy()
    for value in (255, 0):
        parts, _ = ndimage.label(cleaned == value)
        small = np.bincount(parts.ravel()) < _SPECK * np.count_nonzero(mask)
        small[0] = False  # label 0: pixels of the other value
        cleaned[small[parts]] = 255 - value
    return cleaned


def _prior_in_view(station: malus.Station, options: Options, threads: int) -> NDArray[np.float32]:
    """Depth of the station's prior in the polarized image, which must have no distortion."""
    result = malus.reconstruct(station, options, until="prior", threads=threads)
    if result.prior_depth is None:
        raise DataError("there is no [prior] to see yet: the run makes it from the photos")
    return result.prior_depth


def outline_of_prior(station: malus.Station, options: Options, threads: int) -> bytes:
    """PNG of the pixels that the prior covers.

    Raises InputError for a lens with distortion: the prior lies in the undistorted image, the mask in the image as taken.
    """
    if distorting(station.describe().get("camera")) is not None:
        raise InputError(
            "the outline of the prior is for lenses without distortion, expected another tool for this one"
        )
    return encode(np.where(np.isfinite(_prior_in_view(station, options, threads)), 255, 0).astype(np.uint8), "PNG")


def overlay_of_prior(station: malus.Station, threads: int) -> tuple[str, float, tuple[float, float]]:
    """Data URL of the prior's points in the image as taken, colored by distance and transparent where there is no point; the side of
    a pixel of this picture in pixels of the image; and the nearest and farthest distance of the color scale.
    """
    image, _, points = prior_upon_image(station, threads=threads)
    if not len(points):
        raise DataError("the coarse surface covers no pixel of the polarized image, or there is none yet")
    distance, cell = nearest_points(points, image.shape)
    near, far = (float(p) for p in np.nanpercentile(distance, [1, 99]))
    return data_url(colored(distance, "viridis_r", near, far), "PNG", compress_level=3), cell, (near, far)
