"""TOML files of users, read in bounded time and memory."""

from __future__ import annotations

import io
import math
import re
import tomllib
from pathlib import Path
from typing import Any

from malus._files import open_regular

_MOST_PARTS = 100
_INTEGERS = range(-(2**63), 2**63)
_KEY = re.compile(r"^[ \t\[]*([\w.\-\"' \t]*)", re.ASCII | re.MULTILINE)


def read_toml(path: Path) -> dict[str, Any]:
    """Content of a TOML file. Raises OSError, UnicodeDecodeError, RecursionError or tomllib.TOMLDecodeError.

    As in the C++ library, keys with very many parts (tomllib takes gigabytes for one of 50 000) and numbers beyond the range of
    a double or of a 64-bit integer are errors. The byte order mark with which Windows' editors begin UTF-8 files is skipped.
    """
    with io.TextIOWrapper(open_regular(path), encoding="utf-8-sig") as file:
        text = file.read()
    for key in _KEY.finditer(text):
        if key[1].count(".") >= _MOST_PARTS:
            line = text.count("\n", 0, key.start()) + 1
            raise tomllib.TOMLDecodeError(f"line {line}: a key of more than {_MOST_PARTS} parts")
    try:
        content = tomllib.loads(text, parse_float=_finite)
    except tomllib.TOMLDecodeError:
        raise
    except ValueError as error:  # an integer of more digits than Python reads, or the error of _finite
        raise tomllib.TOMLDecodeError(str(error)) from None
    _require_64_bits(content)
    return content


def _finite(digits: str) -> float:
    value = float(digits)
    if math.isinf(value) and "inf" not in digits:
        raise ValueError(f"{digits[:40]} is beyond what a number can be")
    return value


def _require_64_bits(value: object) -> None:
    if isinstance(value, int) and value not in _INTEGERS:
        raise tomllib.TOMLDecodeError("a whole number is beyond 64 bits")
    for inner in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        _require_64_bits(inner)
