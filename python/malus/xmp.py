"""Catalog entries and statements about the surface in image files (XMP, ISO 16684-1), and the color space of images (ICC)."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageCms
from PIL.PngImagePlugin import PngInfo

from malus import _core
from malus._files import replacing, write_bytes
from malus.errors import InputError

#: TIFF tag of an XMP packet.
_XMP_TAG = 700
#: XML namespace of the properties that say how far the surface may be trusted.
NAMESPACE = "urn:malus:surface/"
#: [object] key → property of Dublin Core and its RDF container: "Alt" for text in several languages, "Seq" or "Bag" for lists, "" for none.
#: Two keys get a property of our own: in XMP dc:format is the type of the file, and a second dc:date would be taken for another date of the
#: object.
_PROPERTIES = {
    "title": ("dc:title", "Alt"),
    "identifier": ("dc:identifier", ""),
    "maker": ("dc:creator", "Seq"),
    "recorded_by": ("dc:contributor", "Bag"),
    "recorded_on": ("malus:recorded_on", ""),
    "date": ("dc:date", "Seq"),
    "place": ("dc:coverage", ""),
    "material": ("malus:material", ""),
    "collection": ("dc:relation", "Bag"),
    "description": ("dc:description", "Alt"),
    "rights": ("dc:rights", "Alt"),
    "license": ("xmpRights:UsageTerms", "Alt"),
}


def packet(name: str, words: Mapping[str, str], surface: Mapping[str, str]) -> str:
    """XMP packet with the entries of [object] (`words`) and the statements of malus.trust (`surface`); `name` is the title if there is none."""
    lines = [f"   <malus:{key}>{escape(value)}</malus:{key}>" for key, value in surface.items() if value]
    for key, (property_name, kind) in _PROPERTIES.items():
        value = words.get(key) or (name if key == "title" else "")
        if not value:
            continue
        text = escape(str(value))
        if kind:
            language = ' xml:lang="x-default"' if kind == "Alt" else ""
            text = f"<rdf:{kind}><rdf:li{language}>{text}</rdf:li></rdf:{kind}>"
        lines.append(f"   <{property_name}>{text}</{property_name}>")
    return (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>\n'
        '<x:xmpmeta xmlns:x="adobe:ns:meta/">\n'
        ' <rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">\n'
        '  <rdf:Description rdf:about="" xmlns:dc="http://purl.org/dc/elements/1.1/" '
        'xmlns:xmp="http://ns.adobe.com/xap/1.0/" xmlns:xmpRights="http://ns.adobe.com/xap/1.0/rights/" '
        f'xmlns:malus="{NAMESPACE}">\n'
        f"   <xmp:CreatorTool>Malus {_core.version}</xmp:CreatorTool>\n" + "\n".join(lines) + "\n"
        "  </rdf:Description>\n </rdf:RDF>\n</x:xmpmeta>\n"
        '<?xpacket end="w"?>'
    )


@cache
def srgb_profile() -> bytes:
    """ICC profile of sRGB, always the same bytes."""
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    # The library writes the time of the call as the profile's date (bytes 24 to 35), so that no two exports were equal.
    return profile[:24] + struct.pack(">6H", 2000, 1, 1, 0, 0, 0) + profile[36:]


def save_png(path: Path, picture: NDArray[np.uint8], xmp: str, *, dpi: float | None = None) -> None:
    """Write sRGB colors (H×W×3, or ×4 with alpha) as PNG with color profile and XMP; dpi: pixels per inch on the object."""
    told = PngInfo()
    told.add_itxt("XML:com.adobe.xmp", xmp)
    resolution = None if dpi is None else (dpi, dpi)
    with replacing(path) as temporary:
        Image.fromarray(picture).save(temporary, pnginfo=told, icc_profile=srgb_profile(), dpi=resolution)


def tag_png(path: Path, xmp: str) -> None:
    """Put an XMP packet into a PNG file that has none; its pixels are unchanged."""
    content = path.read_bytes()
    # Keyword, no compression, no language. The chunk goes behind the signature (8 bytes) and the header (25).
    chunk = b"iTXtXML:com.adobe.xmp" + b"\0" * 5 + xmp.encode()
    packed = struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
    write_bytes(path, content[:33] + packed + content[33:])


def tag_tiff(path: Path, xmp: str) -> None:
    """Put an XMP packet into a TIFF file that has none; its pixels are unchanged.

    A new directory is written at the end of the file. InputError unless the file is a classic TIFF with one directory.
    """
    content = path.read_bytes()
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(content[:4])
    if order is None:
        raise InputError(f"{path}: is no classic TIFF, expected one of less than 4 GB")
    (start,) = struct.unpack_from(order + "I", content, 4)
    (count,) = struct.unpack_from(order + "H", content, start)
    entries = [content[start + 2 + 12 * k : start + 14 + 12 * k] for k in range(count)]
    tags = [struct.unpack(order + "H", entry[:2])[0] for entry in entries]
    (following,) = struct.unpack_from(order + "I", content, start + 2 + 12 * count)
    if _XMP_TAG in tags or following:
        raise InputError(f"{path}: has an XMP packet or several directories already")
    packed = xmp.encode()
    # TIFF requires even offsets.
    place = len(content) + len(content) % 2
    directory = place + len(packed) + len(packed) % 2
    if directory > 0xFFFF0000:
        raise InputError(f"{path}: is too large for a classic TIFF")
    entries.append(struct.pack(order + "HHII", _XMP_TAG, 1, len(packed), place))
    entries.sort(key=lambda entry: struct.unpack(order + "H", entry[:2])[0])
    added = content[:4] + struct.pack(order + "I", directory) + content[8:] + b"\0" * (place - len(content)) + packed
    added += b"\0" * (directory - len(added)) + struct.pack(order + "H", len(entries)) + b"".join(entries)
    write_bytes(path, added + struct.pack(order + "I", 0))
