"""The templates of Malus's HTML pages. Each page is one file that contains its styles, scripts and pictures."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from importlib import resources
from typing import Any

import jinja2
from markupsafe import Markup

from malus.columns import number


def asset(name: str) -> Markup:
    """The text of a file of malus/assets, not escaped."""
    return Markup(_text("assets", name))


def base64_text(content: bytes) -> str:
    """Bytes as base64 text."""
    return base64.b64encode(content).decode()


def template(name: str, filters: Mapping[str, Callable[..., Any]] | None = None) -> jinja2.Template:
    """A template of malus/templates, with the function `asset`, the filters `base64` (of bytes) and `number`, and the given ones.

    Values are escaped; a value that was not given is an error.
    """
    environment = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        loader=jinja2.FunctionLoader(lambda name: _text("templates", name)),
    )
    # Names in any script can be read in the page, and keys have the order that the file has.
    environment.policies["json.dumps_kwargs"] = {"ensure_ascii": False}
    environment.filters["base64"] = base64_text
    environment.filters["number"] = number
    environment.filters.update(filters or {})
    environment.globals["asset"] = asset
    return environment.get_template(name)


def _text(folder: str, name: str) -> str:
    return resources.files("malus").joinpath(folder, name).read_text(encoding="utf-8")
