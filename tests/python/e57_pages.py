"""Pages of E57 files. Each has 1024 bytes, of which the last four are a checksum, so that changed bytes are not read without it."""

from __future__ import annotations

_PAGE, _CONTENT = 1024, 1020
#: Places in the header: length of the file, start of its XML (as a place in the file) and length of the XML.
_FILE_LENGTH, _XML, _XML_LENGTH = slice(16, 24), slice(24, 32), slice(32, 40)
_END = b"</e57Root>"


def _table() -> list[int]:
    table = list(range(256))
    for _ in range(8):
        table = [value >> 1 ^ (0x82F63B78 if value & 1 else 0) for value in table]
    return table


_TABLE = _table()


def _checksum(content: bytes) -> bytes:
    """CRC-32C."""
    value = 0xFFFFFFFF
    for byte in content:
        value = value >> 8 ^ _TABLE[(value ^ byte) & 255]
    return (value ^ 0xFFFFFFFF).to_bytes(4, "big")


def content_of(file: bytes) -> bytes:
    """The bytes of an E57 file without checksums."""
    return b"".join(file[start : start + _CONTENT] for start in range(0, len(file), _PAGE))


def as_file(content: bytes, beyond: int = 0) -> bytes:
    """An E57 file of these bytes, with its own length and that of its XML, which may go beyond its root, in its header."""
    count = -(-len(content) // _CONTENT)
    whole = bytearray(content.ljust(count * _CONTENT, b"\0"))
    whole[_FILE_LENGTH] = (count * _PAGE).to_bytes(8, "little")
    pages, rest = divmod(int.from_bytes(whole[_XML], "little"), _PAGE)
    begin, end = pages * _CONTENT + rest, content.rfind(_END) + len(_END)
    if begin < end:
        whole[_XML_LENGTH] = (end - begin + beyond).to_bytes(8, "little")
    parts = (bytes(whole[start : start + _CONTENT]) for start in range(0, count * _CONTENT, _CONTENT))
    return b"".join(part + _checksum(part) for part in parts)
