"""TOML files of users, read by the C++ library within bounded time and memory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from malus import _core


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Content of a TOML file; dates, inf and nan are text. `what`: its name in messages. InputError if it cannot be read."""
    content: dict[str, Any] = json.loads(_core.toml_as_json(path, what))
    return content
