"""The head of the report, beside the confidence: a photograph, size and accuracy of the surface, and what polarization changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from malus import _core
from malus.columns import number
from malus.figures import Plates
from malus.lengths import scale_bar, shown, sides
from malus.pictures import encode
from malus.trust import is_the_prior
from malus.workspace import Workspace

#: Ratio of two spreads from which on the report calls the surface rougher or flatter.
_NOTABLE = 1.1
#: Share of the object without data in the prior from which on the report mentions it beside the coverage.
_NOTABLE_HOLES = 0.1


@dataclass(frozen=True)
class Head:
    """The first screen of the report."""

    photograph: bytes
    width_px: int
    height_px: int
    #: Width of the scale bar in percent of the photograph's width, and its length as text.
    bar_percent: float
    bar_label: str
    size: str
    accuracy: str
    accuracy_note: str
    pixel: str
    #: What the coverage means.
    covered_note: str
    gains_title: str
    gains: list[str]
    finishes: str


def size_of_object(workspace: Workspace) -> tuple[float, float] | None:
    """Width and height of the object [station's unit] from the prior in the station's view; None if no check has measured them."""
    if not workspace.has("evidence/findings.json"):
        return None
    found = [finding["figures"] for finding in workspace.findings if finding["check"] == "size"]
    return (found[0]["width"], found[0]["height"]) if found and {"width", "height"} <= found[0].keys() else None


def head_of(plates: Plates, extent: list[float]) -> Head:
    """The head for a workspace; `extent`: width and height of the surface [station's unit], used if the prior's are not known."""
    quality, unit = plates.quality, plates.unit
    window = plates.object_box()
    color = plates.workspace.color()
    color = color if color.ndim == 3 else color[..., None]
    small = np.stack([plates.small(color[..., c]) for c in range(color.shape[2])], -1)[window]
    picture = np.nan_to_num(np.broadcast_to(small, (*small.shape[:2], 3))).astype(np.float32)
    # All pixels of the window determine the brightness, not only those with a surface.
    shown_picture = _core.display_image(
        np.ascontiguousarray(picture), np.ones(picture.shape[:2], dtype=np.float32), 99.0
    )
    width = picture.shape[1] * plates.gsd * plates.step
    size = size_of_object(plates.workspace) or (extent[0], extent[1])
    length, label = scale_bar(width, unit)
    accuracy, note = accuracy_of(quality, plates.gsd)
    return Head(
        encode(shown_picture, "WEBP", quality=88), picture.shape[1], picture.shape[0], 100 * length / width, label,
        sides(size, unit), accuracy, note, shown(plates.gsd, unit, 3), covered_of(quality), gains_title(quality),
        gains_of(quality, unit), finishes_of(quality),
    )  # fmt: skip


def accuracy_of(quality: Mapping[str, Any], gsd: float) -> tuple[str, str]:
    """The surface's standard deviation as text, and a note on what it means."""
    if not quality["sigma"] or quality["sigma"]["median_gsd"] is None:
        return "not known", "the run did not estimate it"
    median, most = (shown(quality["sigma"][key] * gsd, quality["unit"]) for key in ("median_gsd", "p95_gsd"))
    if quality["confidence"]["level"] == "low":
        return f"at best {median}", "as computed if the inputs and the model are right, which the reasons put in doubt"
    return median, f"one standard deviation of the depth, median; on 95 % of the surface below {most}"


def covered_of(quality: Mapping[str, Any]) -> str:
    """What the share of pixels with a surface means."""
    note = "of the object's pixels have a surface"
    filled = (quality.get("prior") or {}).get("filled_fraction") or 0.0
    return (
        note
        if filled < _NOTABLE_HOLES
        else f"{note}; on {100 * filled:.0f} % the coarse one has no data, and it is a guess"
    )


def is_worse(patch: Mapping[str, Any]) -> bool:
    """Whether fusion made a flat patch notably rougher."""
    return bool(patch["prior"] and patch["fused"]) and patch["fused"]["rmse"] > _NOTABLE * patch["prior"]["rmse"]


def is_better(patch: Mapping[str, Any]) -> bool:
    """Whether fusion made a flat patch notably flatter."""
    return bool(patch["prior"] and patch["fused"]) and patch["prior"]["rmse"] > _NOTABLE * patch["fused"]["rmse"]


def _flatter(patch: Mapping[str, Any]) -> str:
    """How much flatter or rougher fusion made a flat patch, without a number if one of the surfaces is an exact plane."""
    before, after = patch["prior"]["rmse"], patch["fused"]["rmse"]
    if not (is_better(patch) or is_worse(patch)):
        return "as flat as before"
    word, low, high = ("flatter", after, before) if is_better(patch) else ("rougher", before, after)
    return f"{number(high / low, 2)} times {word}" if low > 0 else word


def gains_title(quality: Mapping[str, Any]) -> str:
    """Heading of the changes. They are called a gain only if a flat patch became flatter, none rougher, and the confidence is not low."""
    patches = quality["patches"]
    proven = any(is_better(patch) for patch in patches) and not any(is_worse(patch) for patch in patches)
    gained = quality["confidence"]["level"] != "low" and proven
    return f"What {'was gained over' if gained else 'fusion changed against'} the coarse surface alone"


def gains_of(quality: Mapping[str, Any], unit: str) -> list[str]:
    """Sentences on what fusion changed compared with the coarse surface; none if the result is the coarse surface."""
    if is_the_prior(quality):
        return []
    lines = []
    for patch in quality["patches"]:
        if patch["prior"] and patch["fused"]:
            before, after = patch["prior"]["rmse"], patch["fused"]["rmse"]
            lines.append(
                f"The flat patch “{patch['name']}” is {_flatter(patch)}: {shown(after, unit)} from a plane (RMSE), with the coarse surface alone {shown(before, unit)}."
            )
    compared = quality["prior_vs_fused"]
    if compared:
        before, after, changed = (
            shown(compared[key] * quality["gsd"], unit)
            for key in ("prior_detail_mad_gsd", "fused_detail_mad_gsd", "difference_detail_mad_gsd")
        )
        lines.append(
            f"Fine relief has a spread of {after}, with the coarse surface alone {before}; fusion changed it by {changed} (robust σ)."
        )
    return lines


def finishes_of(quality: Mapping[str, Any]) -> str:
    """A sentence if the refinement found two finishes on the object; "" if it found one."""
    found = (quality.get("refinement") or {}).get("surroundings") or {}
    if not found.get("other_finish_share"):
        return ""
    usual, other, percent = found["roughness"], found["other_roughness"], 100 * found["other_finish_share"]
    share = f"about {percent:.0f} %" if percent >= 1 else "less than 1 %"
    return (
        f"The object has two finishes, like glaze beside bare clay: {share} of it is "
        f"{'duller' if other > usual else 'glossier'} than the rest (roughness {other:.2g} against {usual:.2g})."
    )
