"""Pictures of a surface for IIIF viewers (Mirador, Universal Viewer, OpenSeadragon): a folder of files that any web server can serve.

Presentation API 3.0 manifest; Image API 3.0, level 0: all tiles and sizes are files in the folder, so the server computes nothing.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from malus import _core
from malus._files import new_folder
from malus.errors import InputError
from malus.xmp import srgb_profile

TILE_PX = 512
_QUALITY = 90
_LABELS = {
    "maker": "Maker",
    "date": "Date",
    "place": "Place",
    "material": "Material",
    "identifier": "Identifier",
    "collection": "Collection",
    "recorded_by": "Recorded by",
    "recorded_on": "Recorded on",
    "license": "License",
}
#: Pages about a license or a statement, in any language, whose addresses people copy.
_LICENSE = re.compile(
    r"https?://(?:www\.)?creativecommons\.org/((?:licenses|publicdomain)/[a-z+-]+/\d\.\d/(?:[a-z]{2,4}/)?)"
    r"(?:(?:deed|legalcode)[\w.-]*)?$"
)
_STATEMENT = re.compile(r"https?://(?:www\.)?rightsstatements\.org/(?:vocab|page)/([A-Za-z-]+/\d\.\d/)(?:\?\S*)?$")


def rights_of(license: str) -> str | None:
    """A license's address as the specification wants it in `rights`, from that of any page about it; None for other texts."""
    address = license if license.endswith("/") or "?" in license else f"{license}/"
    for pattern, place in ((_LICENSE, "creativecommons.org"), (_STATEMENT, "rightsstatements.org/vocab")):
        if found := pattern.match(license) or pattern.match(address):
            return f"http://{place}/{found[1]}"
    return None


def scale_factors(width: int, height: int) -> list[int]:
    """Reductions as powers of two, up to the one at which the whole picture fits into one tile."""
    factors = [1]
    while max(width, height) > TILE_PX * factors[-1]:
        factors.append(2 * factors[-1])
    return factors


def write_tiles(folder: Path, picture: NDArray[np.uint8], address: str) -> dict[str, Any]:
    """Write info.json and all tiles and sizes of an sRGB picture (H×W×3) to `folder`, whose web address is `address`; returns info.json."""
    image = Image.fromarray(picture)
    width, height = image.size
    sizes = []
    for factor in scale_factors(width, height):
        small = (-(-width // factor), -(-height // factor))
        sizes.append({"width": small[0], "height": small[1]})
        reduced = image if factor == 1 else image.resize(small, Image.Resampling.LANCZOS)
        _save(reduced, folder / f"full/{small[0]},{small[1]}")
        if factor == 1:
            _save(reduced, folder / "full/max")
        span = TILE_PX * factor
        for y in range(0, height, span):
            for x in range(0, width, span):
                w, h = min(span, width - x), min(span, height - y)
                if (w, h) == (width, height):
                    continue  # this tile is the whole picture, written above
                box = (x // factor, y // factor, -(-(x + w) // factor), -(-(y + h) // factor))
                _save(reduced.crop(box), folder / f"{x},{y},{w},{h}/{box[2] - box[0]},{box[3] - box[1]}")
    info = {
        "@context": "http://iiif.io/api/image/3/context.json",
        "id": address,
        "type": "ImageService3",
        "protocol": "http://iiif.io/api/image",
        "profile": "level0",
        "width": width,
        "height": height,
        "sizes": sizes[::-1],
        "tiles": [{"width": TILE_PX, "height": TILE_PX, "scaleFactors": scale_factors(width, height)}],
    }
    (folder / "info.json").write_text(json.dumps(info, indent=1) + "\n", encoding="utf-8")
    return info


def _save(image: Image.Image, folder: Path) -> None:
    path = folder / "0" / "default.jpg"
    path.parent.mkdir(parents=True, exist_ok=True)
    image.save(path, quality=_QUALITY, icc_profile=srgb_profile())


def _text(value: str) -> dict[str, list[str]]:
    return {"none": [value]}


def _canvas(address: str, name: str, label: str, info: Mapping[str, Any]) -> dict[str, Any]:
    size = {"width": info["width"], "height": info["height"]}
    service = {"id": info["id"], "type": "ImageService3", "profile": "level0"}
    body = {
        "id": f"{info['id']}/full/max/0/default.jpg",
        "type": "Image",
        "format": "image/jpeg",
        **size,
        "service": [service],
    }
    canvas = f"{address}/canvas/{name}"
    painting = {
        "id": f"{canvas}/painting",
        "type": "Annotation",
        "motivation": "painting",
        "body": body,
        "target": canvas,
    }
    page = {"id": f"{canvas}/page", "type": "AnnotationPage", "items": [painting]}
    return {"id": canvas, "type": "Canvas", "label": _text(label), **size, "items": [page]}


def manifest(
    address: str, name: str, words: Mapping[str, str], canvases: list[dict[str, Any]], summary: str
) -> dict[str, Any]:
    """Presentation 3.0 manifest of canvases, with the catalog entries."""
    told = [
        {"label": _text(label), "value": _text(str(words[key]))} for key, label in _LABELS.items() if words.get(key)
    ]
    found: dict[str, Any] = {
        "@context": "http://iiif.io/api/presentation/3/context.json",
        "id": f"{address}/manifest.json",
        "type": "Manifest",
        "label": _text(words.get("title") or name),
        "summary": _text(words.get("description") or summary),
        "metadata": [*told, {"label": _text("Made with"), "value": _text(f"Malus {_core.version}")}],
        "items": canvases,
    }
    if words.get("rights"):
        found["requiredStatement"] = {"label": _text("Rights"), "value": _text(str(words["rights"]))}
    if rights := rights_of(str(words.get("license", ""))):
        found["rights"] = rights
    return found


def write_iiif(
    folder: Path,
    pictures: Mapping[str, tuple[str, NDArray[np.uint8]]],
    *,
    address: str,
    name: str,
    words: Mapping[str, str],
    summary: str,
) -> Path:
    """Write manifest.json and a folder of tiles for each picture (name → label, H×W×3 sRGB) as a new `folder`.

    address: where the folder will be on the web, without a slash at its end. InputError if the folder exists already, or if the
    address is invalid.
    """
    if not re.match(r"https?://[^\s/]+[^\s]*$", address):
        raise InputError(
            f"--url {address}: expected where the folder will be on the web: https://museum.org/iiif/stone"
        )
    address = address.rstrip("/")
    with new_folder(folder) as new:
        canvases = []
        for key, (label, picture) in pictures.items():
            info = write_tiles(new / key, picture, f"{address}/{key}")
            canvases.append(_canvas(address, key, label, info))
        document = manifest(address, name, words, canvases, summary)
        (new / "manifest.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return folder
