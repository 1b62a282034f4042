"""Tables 1 and 2 of the paper from a workspace's figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus.columns import aligned, csv_text, decimals
from malus.figures.profiles import numbers
from malus.workspace import Raster, Workspace

#: Names of the surfaces in quality.json → names in the paper.
SURFACES = {"prior": "photogrammetry", "polarization": "polarization", "fused": "fusion"}
#: Columns that contain text, even if it looks like a number.
WORDS = ("object", "profile", "surface", "patch")


@dataclass(frozen=True)
class Table:
    """One table: every cell is text, a number, or None for an unknown value."""

    name: str
    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str | float | None]]

    def csv(self) -> str:
        """The table as CSV, numbers with all digits."""
        return csv_text(self.header, self.rows)

    def markdown(self) -> str:
        """The table as Markdown, numbers with three digits."""
        lines = [
            list(self.header),
            ["---"] * len(self.header),
            *([cell_text(cell).replace("|", "\\|") for cell in row] for row in self.rows),
        ]
        return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"

    def without_empty(self) -> Table:
        """The table without columns that are empty in all rows."""
        used = [any(row[column] is not None for row in self.rows) for column in range(len(self.header))]
        return replace(
            self, header=list(compress(self.header, used)), rows=[list(compress(row, used)) for row in self.rows]
        )

    def in_columns(self) -> list[list[str]]:
        """The cells as text, with the same number of decimals in all cells of a column."""
        columns = [list(column) for column in zip(*self.rows, strict=True)]
        places = [decimals(cell for cell in column if not isinstance(cell, str)) for column in columns]
        return [
            [cell if isinstance(cell, str) else aligned(cell, at) for cell, at in zip(row, places, strict=True)]
            for row in self.rows
        ]


def cell_text(cell: str | float | None) -> str:
    """A cell as text; numbers have three digits."""
    if cell is None:
        return "–"
    return cell if isinstance(cell, str) else f"{cell:.3g}"


def _known(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)


def _sampled(raster: Raster, profile: Mapping[str, Any]) -> NDArray[np.float64]:
    """Values of a raster at the pixels nearest to the samples of a profile."""
    start, end = np.array(profile["from_px"], float), np.array(profile["to_px"], float)
    along = np.array(profile["position_px"], float)
    at = start + along[:, None] * (end - start) / np.linalg.norm(end - start)
    columns, rows = np.rint(at).astype(int).T
    return np.asarray(raster[rows, columns], dtype=np.float64)


def _rms(values: NDArray[np.float64], *, about_mean: bool) -> float | None:
    known = values[np.isfinite(values)]
    if known.size == 0:
        return None
    return float(np.sqrt(np.mean((known - known.mean() if about_mean else known) ** 2)))


def _errors(profile: Mapping[str, Any], reference_distance: Raster | None) -> dict[str, float | None]:
    """RMSE of each surface to the reference along a profile; for polarization about its mean, because its offset is free."""
    if reference_distance is None or not profile["fused"]:
        return dict.fromkeys(SURFACES)
    fused, error = numbers(profile["fused"]), _sampled(reference_distance, profile)
    return {
        name: _rms(error + numbers(profile[name]) - fused, about_mean=name == "polarization") if profile[name] else None
        for name in SURFACES
    }


def table_1(workspace: Workspace, surfaces: Mapping[str, str] = SURFACES) -> Table:
    """For each surface on each profile: difference from the fused surface, roughness, and, with a reference scan, error.

    `difference` is the RMS about the mean of the surface minus the fused one; for photogrammetry the paper decomposes it with its
    quadratic complement. `roughness` is the RMS of the section without its low frequencies. `error` is the RMSE to the reference;
    distances to the reference are taken as differences in the section's height. `surfaces`: names of the surfaces in the table.
    """
    quality = workspace.quality
    unit, gsd = str(quality["unit"]), float(quality["gsd"])
    distance = (
        workspace.raster("fused/reference_distance.tif")
        if quality["reference"] and workspace.has("fused/reference_distance.tif")
        else None
    )
    rows: list[list[str | float | None]] = []
    if not quality["profiles"]:
        rows.append([str(quality["name"]), "no profile given", None, *[None] * 6])
    for profile in quality["profiles"]:
        errors = _errors(profile, distance)
        differences = {
            "prior": profile["fused_minus_prior"]["rms_centered_gsd"],
            "polarization": profile["fused_minus_polarization"]["rms_centered_gsd"]
            if profile["polarization"]
            else None,
            "fused": None,
        }
        for name, called in surfaces.items():
            rough, difference, error = (
                _known(profile[f"roughness_{name}_gsd"]), _known(differences[name]), _known(errors[name])
            )  # fmt: skip
            rows.append(
                [str(quality["name"]), str(profile["name"]), called]
                + [None if difference is None else difference * gsd, difference]
                + [None if rough is None else rough * gsd, rough]
                + [error, None if error is None else error / gsd]
            )
    columns = (
        f"{what} [{in_}]"
        for what in (f"difference to {surfaces['fused']}", "roughness", "error")
        for in_ in (unit, "GSD")
    )
    return Table(
        "table_1", "Table 1: sections through the surfaces", ["object", "profile", "surface", *columns], rows
    )  # fmt: skip


def table_2(workspace: Workspace) -> Table:
    """Distances of flat patches from their fitted planes, one patch per row.

    An object without patches has one row that says so, because it would seem forgotten if it were missing from a merged table.
    """
    quality = workspace.quality
    unit, gsd = str(quality["unit"]), float(quality["gsd"])
    rows: list[list[str | float | None]] = []
    if not quality["patches"]:
        rows.append([str(quality["name"]), "no flat patch given", gsd, *[None] * 6])
    for patch in quality["patches"]:
        row: list[str | float | None] = [str(quality["name"]), str(patch["name"]), gsd]
        for name in SURFACES:
            fit = patch[name]
            row += [None, None] if fit is None else [_known(fit["rmse"]), _known(fit["rmse_gsd"])]
        rows.append(row)
    columns = (f"{called} {what}" for called in SURFACES.values() for what in (f"RMSE [{unit}]", "RMSE / GSD"))
    return Table("table_2", "Table 2: flat patches", ["object", "patch", f"GSD [{unit}]", *columns], rows)
