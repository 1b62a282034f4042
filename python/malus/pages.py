"""The templates of Malus's HTML pages. Each page is one file: styles, scripts and pictures are inside it."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from importlib import resources
from typing import Any

import jinja2
from markupsafe import Markup


def asset(name: str) -> Markup:
    """A file of malus/assets, as it is."""
    return Markup(_text("assets", name))


def template(name: str, filters: Mapping[str, Callable[..., Any]] | None = None) -> jinja2.Template:
    """A template of malus/templates, with `asset`, the filter `base64` (of bytes) and more filters if given.

    Values are escaped; one that was not given is an error.
    """
    environment = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        loader=jinja2.FunctionLoader(lambda name: _text("templates", name)),
    )
    environment.filters["base64"] = lambda content: base64.b64encode(content).decode()
    environment.filters.update(filters or {})
    environment.globals["asset"] = asset
    return environment.get_template(name)


def _text(folder: str, name: str) -> str:
    return resources.files("malus").joinpath(folder, name).read_text(encoding="utf-8")
