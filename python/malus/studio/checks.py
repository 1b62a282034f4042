"""The messages of `malus check` for a station, each with the field of the page that it concerns."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import malus
from malus.errors import MalusError
from malus.studio.settings import options_of

#: Fields of the page, and patterns of the messages that concern them; the first match counts.
_FIELDS = (
    ("photos", r"\[photos\] masks"),
    ("object", r"\[object\]"),
    ("unit", r"\[station\] unit|\bunit = "),
    ("mask", r"\bmask\b"),
    ("control", r"\[\[control\]\]|control points?"),
    ("angles", r"angle|polarizer|order of the images|direction"),
    ("response", r"white_level|black_level|response|saturated|linear|gamma"),
    ("images", r"\[polarized\]|images?\b.*(cannot be read|no such|size|differ)|exposure time|ISO|aperture"),
    ("camera", r"\[camera\]|camera|lens|\bpose\b"),
    ("prior", r"\[prior\]|cloud|mesh|depth map|prior"),
    ("photos", r"\[photos\]|photos?\b|COLMAP"),
    ("scale", r"\[\[scale\]\]|distance|unit"),
    ("patch", r"\[\[patch\]\]|patch"),
    ("profile", r"\[\[profile\]\]|profile"),
    ("optics", r"refractive|reflection|label|metal"),
)


#: An error on the page only: commands that the page does not offer need no coarse surface.
_NO_SURFACE = {
    "severity": "error",
    "field": "prior",
    "message": "there is no coarse surface yet: choose one, or the photographs from all around of which it is to be made",
}


def field_of(message: str) -> str:
    """The field of the page that a message concerns; "station" if none is named."""
    for field, pattern in _FIELDS:
        if re.search(pattern, message, re.IGNORECASE):
            return field
    return "station"


def check(path: Path, threads: int) -> dict[str, Any]:
    """The plan of a run, and all errors and warnings as lines with severity, field and message."""
    try:
        station = malus.Station.load(path)
        plan = malus.check(station, options_of(path), threads=threads)
    except MalusError as error:
        field = field_of(str(error).replace(str(path), ""))  # words of the path could match another field
        return {"lines": [{"severity": "error", "field": field, "message": str(error)}]}
    lines = [{"severity": "warning", "field": field_of(text), "message": text} for text in plan["warnings"]]
    if not any(step.startswith("fuse:") for step in plan["does"]):
        lines = [line for line in lines if line["field"] != "prior"] + [_NO_SURFACE]
    return {"lines": lines, "plan": plan}
