"""What the report says first beside how sure it is: a photograph, how large and how accurate, what was gained over stereo alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from malus import _core
from malus.figures import Plates, encode
from malus.lengths import scale_bar, shown
from malus.workspace import Workspace

#: A spread that is this much larger or smaller is said to be so.
_NOTABLE = 1.1
#: Share of the object below which next to nothing of it is refined.
_NOWHERE = 0.05


@dataclass(frozen=True)
class Head:
    """The first screen of the report."""

    photograph: bytes
    width_px: int
    height_px: int
    #: Share of the photograph's width that the scale bar takes, per cent, and what it is long.
    bar_percent: float
    bar_label: str
    size: str
    accuracy: str
    accuracy_note: str
    pixel: str
    gains: list[str]


def size_of_object(workspace: Workspace) -> tuple[float, float] | None:
    """Width and height of the object [station's unit] as the prior has it in view; None if nothing says them."""
    if not workspace.has("evidence/findings.json"):
        return None
    found = [finding["figures"] for finding in workspace.findings if finding["check"] == "size"]
    return (found[0]["width"], found[0]["height"]) if found and {"width", "height"} <= found[0].keys() else None


def head_of(plates: Plates, extent: list[float]) -> Head:
    """The head for a workspace; `extent`: width and height of the surface [station's unit], for one whose prior says none."""
    quality, unit = plates.quality, plates.unit
    window = plates.object_box()
    color = plates.workspace.color()
    color = color if color.ndim == 3 else color[..., None]
    small = np.stack([plates.small(color[..., c]) for c in range(color.shape[2])], -1)[window]
    picture = np.nan_to_num(np.broadcast_to(small, (*small.shape[:2], 3))).astype(np.float32)
    # Everything in the window counts for the brightness.
    shown_picture = _core.display_image(
        np.ascontiguousarray(picture), np.ones(picture.shape[:2], dtype=np.float32), 99.0
    )
    width = picture.shape[1] * plates.gsd * plates.step
    size = size_of_object(plates.workspace) or (extent[0], extent[1])
    length, label = scale_bar(width, unit)
    accuracy, note = "not known", "the run did not estimate it"
    if quality["sigma"]:
        accuracy, most = (shown(quality["sigma"][key] * plates.gsd, unit) for key in ("median_gsd", "p95_gsd"))
        note = f"one standard deviation of the depth, median; on 95 % of the object below {most}"
    return Head(
        encode(shown_picture, "WEBP", quality=88), picture.shape[1], picture.shape[0], 100 * length / width, label,
        f"{size[0]:.3g} × {size[1]:.3g} {unit}", accuracy, note, shown(plates.gsd, unit, 3),
        gains_of(quality, unit),
    )  # fmt: skip


def is_the_prior(quality: Mapping[str, Any]) -> bool:
    """Whether the surface is the prior's nearly everywhere, because nothing finer is supported."""
    refined = quality.get("refinement", {}).get("trusted_share")
    return refined is not None and refined < _NOWHERE


def gains_of(quality: Mapping[str, Any], unit: str) -> list[str]:
    """What fusion changed against stereo alone, a sentence each; nothing where the surface is the prior's."""
    if is_the_prior(quality):
        return []
    lines = []
    for patch in quality["patches"]:
        if patch["prior"] and patch["fused"]:
            before, after = patch["prior"]["rmse"], patch["fused"]["rmse"]
            times = before / max(after, 1e-12)
            said = f"{times:.2g} times flatter" if times >= _NOTABLE else "as flat as before" if times > 1 / _NOTABLE else f"{1 / times:.2g} times rougher"  # fmt: skip
            lines.append(
                f"The flat patch {patch['name']} is {said}: {shown(after, unit)} from a plane (RMSE), with stereo alone {shown(before, unit)}."
            )
    compared = quality["prior_vs_fused"]
    if compared:
        before, after, changed = (
            shown(compared[key] * quality["gsd"], unit)
            for key in ("prior_detail_mad_gsd", "fused_detail_mad_gsd", "difference_detail_mad_gsd")
        )
        lines.append(
            f"Fine relief has a spread of {after}, with stereo alone {before}; fusion changed it by {changed} (robust σ)."
        )
    return lines
