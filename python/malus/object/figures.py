"""Figures of an object's quality.json: of its mesh and its stations, and which of them the terminal shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus.batch import Outcome
from malus.lengths import shown, sides
from malus.object import agreement, meshing
from malus.object.agreement import Agreement
from malus.object.doubts import doubted_stations
from malus.object.mesh_file import Coverage
from malus.object.meshing import MOST_TO_SIMPLIFY, ObjectMesh
from malus.object.views import View


def is_closed(triangles: NDArray[np.int64]) -> bool:
    """Whether every edge has two triangles that run along it in opposite directions."""
    edges = meshing.edges_of(triangles)
    count = int(triangles.max()) + 1
    there, back = (np.sort(edges[:, k] * count + edges[:, 1 - k]) for k in (0, 1))
    return bool((there[1:] != there[:-1]).all() and (there == back).all())


def mesh_figures(mesh: ObjectMesh, gsd: float, wanted_closed: bool) -> dict[str, Any]:
    """Size of the mesh, whether it is closed, how much of it was measured and how well."""
    measured = mesh.measured & mesh.even()
    return {
        "vertices": len(mesh.vertices),
        "triangles": len(mesh.triangles),
        # The check takes the whole mesh into memory. Closing does so, too; a large mesh with open borders stays on disk.
        "closed": (wanted_closed or len(mesh.triangles) <= MOST_TO_SIMPLIFY) and is_closed(mesh.triangles),
        "measured_fraction": mesh.measured_fraction(),
        "sigma_median_gsd": float(np.median(mesh.sigma[measured]) / gsd) if measured.any() else None,
        "extent": np.ptp(mesh.vertices, axis=0).tolist(),
    }


def station_figures(
    outcomes: Sequence[Outcome],
    views: Sequence[View],
    agreements: Sequence[Agreement],
    coverage: Coverage,
    gsd: float,
) -> list[dict[str, Any]]:
    """A row for each station, and what of the surface it sees if it is in it (`views`, in the order of `agreements` and `coverage`)."""
    known = {view.name: k for k, view in enumerate(views)}
    rows = []
    for outcome in outcomes:
        row: dict[str, Any] = {"station": outcome["station"], "status": outcome["status"], "reason": outcome["reason"]}
        if outcome["station"] in known:
            k = known[outcome["station"]]
            row |= {
                "gsd": views[k].gsd,
                "quality": outcome["figures"].get("quality"),
                "confidence": outcome["figures"].get("confidence"),
                "reasons": outcome["figures"].get("reasons", ""),
                "seen_fraction": float(coverage.seen[k]),
                "alone_fraction": float(coverage.alone[k]),
                "unsure_fraction": views[k].unsure,
                "max_sigma_gsd": views[k].most_sigma / views[k].gsd,
                "agreement": agreement.agreement_figures([agreements[k]], gsd),
            }
        rows.append(row)
    return rows


def object_summary(quality: Mapping[str, Any]) -> list[str]:
    """The figures that matter first, a line each, for the terminal; the warnings last."""
    mesh, met, unit = quality["mesh"], quality["agreement"], quality["unit"]
    sigma = mesh["sigma_median_gsd"]
    used = sum(row["status"] == "done" for row in quality["stations"])
    lines = [
        f"{quality['name']}: {sides(mesh['extent'], unit)}, {used} of {len(quality['stations'])} stations, one pixel is "
        f"{shown(quality['gsd'], unit)}",
        f"  accuracy: {shown(sigma * quality['gsd'], unit)} (one standard deviation of what was measured, median)"
        if sigma is not None
        else "  accuracy: not known",
        f"  mesh: {mesh['triangles']} triangles, {'closed' if mesh['closed'] else 'open'}; "
        f"{100 * mesh['measured_fraction']:.1f} % of the surface measured",
    ]
    if met["rms_ratio"] is not None:
        lines.append(
            f"  stations off each other: median {met['median_gsd']:.3g} GSD, RMS {met['rms_ratio']:.3g} standard deviations, "
            f"{100 * met['within_two_sigma']:.0f} % within two"
        )
    lines += [f"  {line}" for line in doubted_stations(quality)]
    scan = quality["reference"]
    if scan is not None and scan["status"] == "done":
        lines.append(
            f"  off the reference, near which {100 * scan['compared_fraction']:.1f} % of what was measured lies: median "
            f"{scan['absolute_median_gsd']:.3g} GSD, {100 * scan['within_1_gsd']:.0f} % within 1 GSD; "
            f"{100 * scan['completeness']['1_gsd']:.0f} % of it is there"
        )
    return lines + [f"  warning: {warning}" for warning in quality["warnings"]]
