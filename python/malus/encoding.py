"""The response curve that image files state (color profiles, PNG and EXIF entries), compared with the station file's `response`."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image, ImageCms
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile

from malus import raw
from malus.exif import positive, tags_of

_ICC_PROFILE, _MAKE, _COLOR_SPACE, _GAMMA = 34675, 271, 40961, 42240
_MIDDLE_GRAY = 128
#: Exponent of light as a function of encoded values: above the first a file is encoded for a display, below the second it is linear.
_ENCODED, _LINEAR = 1.5, 1.15


@dataclass(frozen=True)
class Encoding:
    """Whether the file's numbers are proportional to the light, and which entry of the file states it."""

    is_linear: bool
    source: str


def encoding_of(path: Path) -> Encoding | None:
    """The response curve that a file states; None if it states none, or one between linear and a display's."""
    if raw.is_raw(path):
        return Encoding(True, "RAW files are linear")
    tags = tags_of(path)
    info, kind = _entries_of(path)
    profile = info.get("icc_profile") or tags.get(_ICC_PROFILE)
    if isinstance(profile, bytes):
        return _of_profile(profile)
    if "srgb" in info:
        return Encoding(False, "the PNG file says sRGB")
    if isinstance(info.get("gamma"), float) and info["gamma"] > 0:
        return _of_exponent(1 / info["gamma"], f"the PNG file says gamma {1 / info['gamma']:.2g}")
    if (gamma := positive(tags.get(_GAMMA))) is not None:
        return _of_exponent(gamma, f"the EXIF data say gamma {gamma:.2g}")
    # A camera's JPEG files are always encoded. For other formats the color space alone is not conclusive.
    if kind == "JPEG" and (tags.get(_COLOR_SPACE) == 1 or _MAKE in tags):
        return Encoding(False, "it is a JPEG file of a camera")
    return None


def _entries_of(path: Path) -> tuple[dict[str | tuple[int, int], Any], str]:
    """Entries and format of a JPEG or PNG file; of any other file no entries: those of TIFF files are among their tags.

    Not with Image.open, which refuses large images although only the header is read.
    """
    try:
        with path.open("rb") as file:
            start = file.read(2)
            file.seek(0)
            plugin = {b"\xff\xd8": JpegImageFile, b"\x89P": PngImageFile}.get(start)
            if plugin is not None:
                with plugin(file) as image:
                    return dict(image.info), str(image.format)
    except (OSError, ValueError, SyntaxError):
        pass  # what cannot be read is reported where it is needed
    return {}, "TIFF"


def _of_profile(profile: bytes) -> Encoding | None:
    """The encoding of a color profile, from the light that it assigns to a middle gray."""
    try:
        read = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        mode = {"RGB": "RGB", "GRAY": "L"}.get(read.profile.xcolor_space.strip())
        if mode is None:
            return None
        to_lab = ImageCms.buildTransform(
            read, ImageCms.createProfile("LAB"), mode, "LAB", ImageCms.Intent.RELATIVE_COLORIMETRIC
        )
        gray = Image.new("L", (1, 1), _MIDDLE_GRAY).convert(mode)
        lightness = ImageCms.applyTransform(gray, to_lab).getpixel((0, 0))[0] * 100 / 255  # type: ignore[union-attr, index]
    except (ImageCms.PyCMSError, OSError, ValueError, TypeError):
        return None
    light = ((lightness + 16) / 116) ** 3
    name = (read.profile.profile_description or "without a name").strip()
    return _of_exponent(math.log(light) / math.log(_MIDDLE_GRAY / 255), f'its color profile is "{name}"')


def _of_exponent(exponent: float, source: str) -> Encoding | None:
    if exponent > _ENCODED:
        return Encoding(False, source)
    return Encoding(True, source) if 1 / _LINEAR < exponent < _LINEAR else None


def doubts(images: Sequence[Path], response: str) -> list[tuple[str, str]]:
    """Message and suggestion if image files state the opposite of the station file's response; else an empty list."""
    exponent = {"linear": 1.0, "srgb": 2.2}.get(response)
    if exponent is None and response.startswith("gamma:"):
        exponent = positive(response.removeprefix("gamma:"))
    taken = None if exponent is None else _of_exponent(exponent, "")
    if taken is None:  # a lookup table, or a curve that is neither linear nor a display's
        return []
    against = [
        (path, said) for path in images if (said := encoding_of(path)) is not None and said.is_linear != taken.is_linear
    ]
    if not against:
        return []
    path, said = against[0]
    files = path.name if len(against) == 1 else f"{path.name} and {len(against) - 1} more"
    if taken.is_linear:
        return [
            (f"images are encoded for a display by what their files say ({files}: {said.source}), but response = \"{response}\" leaves them so",
             'is response = "srgb" right, or can the camera\'s RAW files be developed linearly?')
        ]  # fmt: skip
    return [
        (f"images are linear by what their files say ({files}: {said.source}), but response = \"{response}\" bends them",
         'is response = "linear" right?')
    ]  # fmt: skip
