"""Checks of the XML of an E57 file, since faulty XML can make libE57 end the program (signal 11): it follows pointers that it never sets.

It asks every scan's points for their prototype, the list of their fields. Of vectors whose children must be alike it compares
the prototypes and the codecs.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

#: Bytes of an E57 file's pages, and of the checksum at the end of each.
_PAGE, _CHECKSUM = 1024, 4
#: Pages that are read at a time. Many, since some versions of expat start a long token again with every part of it.
_AT_ONCE = 1024
#: Most elements nested in each other. libE57's time grows by the square of this number, to half a minute at 100 000.
_DEEPEST = 100


class _Element(NamedTuple):
    name: str
    is_alike: bool  # in a vector whose children must be alike, or such a vector
    lacking: set[str]  # required children that have not appeared yet


def require_fields_of_points(path: Path) -> None:
    """ValueError for a file whose points do not say which fields they have, and for XML that is nested very deeply.

    Names are compared with their prefixes, and what follows the root element is not looked at, both as in libE57.
    """
    parser, opened = expat.ParserCreate(), list[_Element]()
    ended = False

    def start(name: str, attributes: dict[str, str]) -> None:
        if len(opened) == _DEEPEST:
            raise ValueError(f"its XML has more than {_DEEPEST} elements within each other")
        is_alike = bool(opened) and opened[-1].is_alike
        is_of_scan = len(opened) == 3 and opened[1].name == "data3D"
        lacking = set[str]()
        if is_alike and attributes.get("type") == "CompressedVector":
            lacking = {"prototype", "codecs"}
        elif is_of_scan and name == "points":
            lacking = {"prototype"}
        if attributes.get("type") == "Vector" and attributes.get("allowHeterogeneousChildren") != "1":
            is_alike = True
        if opened:
            opened[-1].lacking.discard(name)
        opened.append(_Element(name, is_alike, lacking))

    def end(_: str) -> None:
        nonlocal ended
        if opened.pop().lacking:
            raise ValueError("its points do not say which fields they have")
        ended = not opened

    def refuse_doctype(*_: object) -> None:
        raise ValueError("its XML has a document type")  # libE57 might read other elements than expat

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler = refuse_doctype
    for content in _from_xml_on(path):
        try:
            parser.Parse(content)
        except expat.ExpatError:
            if not ended:
                raise
        if ended:
            return


def _from_xml_on(path: Path) -> Iterator[bytes]:
    """The content of the file's pages, from the start of its XML on. None if libE57 refuses the pages themselves."""
    with path.open("rb") as file:
        start, page = struct.unpack("<24xQ8xQ", file.read(48).ljust(48, b"\0"))
        if page != _PAGE:
            return
        first, skipped = divmod(min(start, path.stat().st_size), _PAGE)
        file.seek(first * _PAGE)
        while pages := file.read(_AT_ONCE * _PAGE):
            content = (pages[at + skipped * (at == 0) : at + _PAGE - _CHECKSUM] for at in range(0, len(pages), _PAGE))
            yield b"".join(content)
            skipped = 0
