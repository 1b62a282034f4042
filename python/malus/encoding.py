"""The response curve that image files state (color profiles, PNG and EXIF entries), compared with the station file's `response`."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image, ImageCms
from PIL.ExifTags import Base
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile

from malus import raw
from malus.exif import positive, tags_of

_MIDDLE_GRAY, _DARK_GRAY = 128, 32
#: Exponent of light as a function of encoded values: above the first a file is encoded for a display, below the second it is linear.
_ENCODED, _LINEAR = 1.5, 1.15
#: Ratio of two exponents from which they are different encodings: gamma 1.8 and sRGB, but not gamma 2.2 or L* and sRGB.
_OTHER = 1.15
#: A curve whose exponents at the dark and at the middle gray are this close is a power; sRGB and L* differ by 0.2 and more.
_POWER = 0.08
_SRGB_EXPONENT = 2.2
#: Half a step of the lightness in 8 bits, so that black has a logarithm.
_LEAST_LIGHTNESS = 0.2


@dataclass(frozen=True)
class Encoding:
    """Whether the file's numbers are proportional to the light, and which entry of the file states it.

    exponent: light as a power of the encoded middle gray, None if the file only says that it is encoded; response: the value of a
    station file that fits.
    """

    is_linear: bool
    source: str
    exponent: float | None = None
    response: str = "srgb"


def encoding_of(path: Path) -> Encoding | None:
    """The response curve that a file states; None if it states none, or one between linear and a display's."""
    if raw.is_raw(path):
        return Encoding(True, "RAW files are linear", 1.0, "linear")
    tags = tags_of(path)
    info, kind = _entries_of(path)
    profile = info.get("icc_profile") or tags.get(Base.InterColorProfile)
    if isinstance(profile, bytes):
        return _of_profile(profile)
    if "srgb" in info:
        return Encoding(False, "the PNG file says sRGB", _SRGB_EXPONENT)
    if isinstance(info.get("gamma"), float) and info["gamma"] > 0:
        return _of_exponent(1 / info["gamma"], f"the PNG file says gamma {1 / info['gamma']:.2g}")
    if (gamma := positive(tags.get(Base.Gamma))) is not None:
        return _of_exponent(gamma, f"the EXIF data say gamma {gamma:.2g}")
    # A camera's JPEG files are always encoded. For other formats the color space alone is not conclusive.
    if kind == "JPEG" and (tags.get(Base.ColorSpace) == 1 or Base.Make in tags):
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
    """The encoding of a color profile, from the light that it assigns to a middle and to a dark gray."""
    try:
        read = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        mode = {"RGB": "RGB", "GRAY": "L"}.get(read.profile.xcolor_space.strip())
        if mode is None:
            return None
        to_lab = ImageCms.buildTransform(
            read, ImageCms.createProfile("LAB"), mode, "LAB", ImageCms.Intent.RELATIVE_COLORIMETRIC
        )
        exponents = []
        for level in (_MIDDLE_GRAY, _DARK_GRAY):
            gray = Image.new("L", (1, 1), level).convert(mode)
            lightness = ImageCms.applyTransform(gray, to_lab).getpixel((0, 0))[0] * 100 / 255  # type: ignore[union-attr, index]
            exponents.append(math.log(_light(max(lightness, _LEAST_LIGHTNESS))) / math.log(level / 255))
    except (ImageCms.PyCMSError, OSError, ValueError, TypeError):
        return None
    name = (read.profile.profile_description or "without a name").strip()
    return _of_exponent(
        exponents[0], f'its color profile is "{name}"', is_power=abs(exponents[0] - exponents[1]) < _POWER
    )


def _light(lightness: float) -> float:
    """Relative luminance of a CIE lightness L*."""
    return ((lightness + 16) / 116) ** 3 if lightness > 8 else lightness / 903.3


def _of_exponent(exponent: float, source: str, *, is_power: bool = False) -> Encoding | None:
    """is_power: the curve is known to be a power; exponents of sRGB are also written for its own curve."""
    if exponent > _ENCODED:
        is_srgb = not is_power and _SRGB_EXPONENT / _OTHER < exponent < _OTHER * _SRGB_EXPONENT
        return Encoding(False, source, exponent, "srgb" if is_srgb else f"gamma:{exponent:.2g}")
    return Encoding(True, source, exponent, "linear") if 1 / _LINEAR < exponent < _LINEAR else None


def _contradict(a: Encoding, b: Encoding) -> bool:
    if a.is_linear != b.is_linear:
        return True
    if a.is_linear or a.exponent is None or b.exponent is None:
        return False
    return max(a.exponent, b.exponent) > _OTHER * min(a.exponent, b.exponent)


def exponent_of(response: str) -> float | None:
    """Light as a power of the number by a station file's response, about for "srgb"; None for a lookup table."""
    if response.startswith("gamma:"):
        return positive(response.removeprefix("gamma:"))
    return {"linear": 1.0, "srgb": _SRGB_EXPONENT}.get(response)


def doubts(images: Sequence[Path], response: str) -> list[tuple[str, str, str]]:
    """Check, message and suggestion if image files state another encoding than the station file's response; else an empty list.

    The check is "encoding" if one of the two is linear, or "curve" if both are for a display.
    """
    exponent = exponent_of(response)
    taken = None if exponent is None else _of_exponent(exponent, "")
    if taken is None:  # a lookup table, or a curve that is neither linear nor a display's
        return []
    against = [(path, said) for path in images if (said := encoding_of(path)) is not None and _contradict(said, taken)]
    if not against:
        return []
    path, said = against[0]
    files = path.name if len(against) == 1 else f"{path.name} and {len(against) - 1} more"
    if taken.is_linear:
        return [
            ("encoding",
             f"images are encoded for a display according to their files ({files}: {said.source}), but response = \"{response}\" takes them as linear",
             f'is response = "{said.response}" right, or can the camera\'s RAW files be developed linearly?')
        ]  # fmt: skip
    if not said.is_linear:
        return [
            ("curve",
             f"images have another encoding according to their files ({files}: {said.source}) than response = \"{response}\"",
             f'is response = "{said.response}" right?')
        ]  # fmt: skip
    return [
        ("encoding",
         f"images are linear according to their files ({files}: {said.source}), but response = \"{response}\" decodes them",
         'is response = "linear" right?')
    ]  # fmt: skip


def mosaic_doubts(images: Sequence[Path], is_mosaic: bool) -> list[tuple[str, str, str]]:
    """Check, message and suggestion if the image of a polarization camera is a JPEG file; else an empty list. Neighboring pixels are
    behind other polarizers, and JPEG drops just the differences between neighbors.
    """
    lossy = [path for path in images if is_mosaic and _entries_of(path)[1] == "JPEG"]
    return [
        (
            "texture",
            f"{path.name} is a JPEG file, whose compression mixes the polarizers of a mosaic's neighboring pixels",
            "can the camera save PNG or TIFF?",
        )
        for path in lossy
    ]
