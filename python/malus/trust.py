"""How far a surface may be trusted, in words: for the report's head, and for files that leave the workspace."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from malus import _core

#: Share of the object below which next to nothing of it is refined, and above which nearly all of it is.
_NOWHERE, _EVERYWHERE = 0.05, 0.9


def refined_share(quality: Mapping[str, Any]) -> float | None:
    """Share of the object where the surface is finer than its prior; None if the run did not find out."""
    share: float | None = quality.get("refinement", {}).get("trusted_share")
    return share


def is_the_prior(quality: Mapping[str, Any]) -> bool:
    """Whether the surface is the prior's nearly everywhere, because nothing finer is supported."""
    refined = refined_share(quality)
    return refined is not None and refined < _NOWHERE


def what_to_trust(quality: Mapping[str, Any]) -> str:
    """The confidence as one sentence for someone who looks for five seconds."""
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
    if refined < _EVERYWHERE:
        return (
            f"Fine detail is likely where the map is blue-green ({100 * refined:.0f} % of the object). "
            "Elsewhere this is the coarse surface it started from (the prior)."
        )
    return "Fine detail is likely on nearly all of the object. The reasons below say what is less sure."


def origin_of_detail(quality: Mapping[str, Any]) -> str:
    """How much of the surface is finer than the coarse one that it was made from, for files that have no map of it."""
    refined = refined_share(quality)
    if refined is None:
        return "detail from polarization everywhere, which nothing proves"
    if is_the_prior(quality):
        return "the surface is the prior's (the coarse surface it was made from), no finer"
    if refined >= _EVERYWHERE:
        return "detail from polarization on nearly all of the object"
    return f"detail from polarization on {100 * refined:.0f} % of the object, elsewhere the prior's surface, no finer"


def words_of(quality: Mapping[str, Any]) -> dict[str, str]:
    """What a file says of the surface in it: unit, pixel, confidence and its reasons, origin of the detail, program."""
    confidence = quality["confidence"]
    return {
        "unit": quality["unit"],
        "pixel": f"{quality['gsd']:.4g} {quality['unit']}",
        "confidence": confidence["level"],
        "reasons": " ".join(confidence["reasons"]),
        "detail": origin_of_detail(quality),
        "made_by": f"Malus {_core.version}",
    }
