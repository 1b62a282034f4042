"""How far a surface may be trusted, in words: for the report's head, and for exported files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from malus import _core


def refined_share(quality: Mapping[str, Any]) -> float | None:
    """Share of the object where the surface is finer than its prior; None if the run did not determine it."""
    return _core.refined_share(json.dumps(quality))


def is_the_prior(quality: Mapping[str, Any]) -> bool:
    """Whether the fused surface equals the prior nearly everywhere, because the data support no finer detail."""
    refined = refined_share(quality)
    return refined is not None and refined < _core.refined_nowhere


def what_to_trust(quality: Mapping[str, Any]) -> str:
    """The confidence in a sentence or two, for a reader who has five seconds."""
    level = quality["confidence"]["level"]
    refined = refined_share(quality)
    if level == "low":
        return "Do not rely on this surface: the reasons below speak against it."
    if level == "high":
        return "Shape and fine detail can be trusted on nearly all of the object."
    if refined is None:
        return "The shape is as good as the coarse surface it came from (the prior). Nothing proves the fine detail."
    if is_the_prior(quality):
        return "This is the coarse surface it started from (the prior), no finer and no worse."
    if refined < _core.refined_everywhere:
        return (
            f"Fine detail is likely where the map is blue-green ({100 * refined:.0f} % of the object). "
            "Elsewhere this is the coarse surface it started from (the prior)."
        )
    return "Fine detail is likely on nearly all of the object. The reasons below say what is less sure."


def said_of(quality: Mapping[str, Any]) -> dict[str, str]:
    """What every exported file states about its surface, one line each: the entries of [object], unit, pixel, confidence and its
    reasons, origin of the detail, program. The files that a run itself writes get these lines from the same C++ function.
    """
    said: dict[str, str] = json.loads(_core.surface_words(json.dumps(quality)))
    return said


def extras_of(quality: Mapping[str, Any], versions: Mapping[str, str]) -> str:
    """The statements of `said_of` as JSON, for asset.extras of a GLB file."""
    return _core.surface_extras(json.dumps(quality), json.dumps(versions))


def words_of(quality: Mapping[str, Any]) -> dict[str, str]:
    """The statements of `said_of` without the catalog entries: unit, pixel, confidence and its reasons, origin of the detail, program."""
    said = said_of(quality)
    return {key: said.get(key, "") for key in ("unit", "pixel", "confidence", "reasons", "detail", "made_by")}
