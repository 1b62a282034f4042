"""TOML files of users, read with bounded work."""

from __future__ import annotations

import io
import re
import tomllib
from pathlib import Path
from typing import Any

from malus._files import open_regular

_MOST_PARTS = 100
_KEY = re.compile(r"^[ \t\[]*([\w.\-\"' \t]*)", re.ASCII | re.MULTILINE)


def read_toml(path: Path) -> dict[str, Any]:
    """Content of a TOML file. Raises OSError, UnicodeDecodeError, RecursionError or tomllib.TOMLDecodeError.

    A key of very many parts is refused, as the library does: tomllib takes gigabytes for one of 50 000.
    """
    with io.TextIOWrapper(open_regular(path), encoding="utf-8") as file:
        text = file.read()
    for key in _KEY.finditer(text):
        if key[1].count(".") >= _MOST_PARTS:
            line = text.count("\n", 0, key.start()) + 1
            raise tomllib.TOMLDecodeError(f"line {line}: a key of more than {_MOST_PARTS} parts")
    return tomllib.loads(text)
