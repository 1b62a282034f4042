"""What may be wrong with an object's surface: the warnings in quality.json, and stations that are not fully trusted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from malus.batch import Outcome
from malus.object.definition import Object
from malus.workspace import Workspace

#: Stations that lie off the others by more than this many standard deviations (RMS) get a warning (docs/tutorials/whole-object.md).
_WORTH_A_WARNING = 2.0
#: So do stations for which more than this share of the comparisons with others are contradictions. On a rendered figurine with
#: six stations none are, and at most .1 % with --fusion grid, so that a few percent are no accident.
_MOST_CONTRADICTED = 0.03
#: So do stations of whose surface more than this share is too unsure for the mesh.
_MOST_UNSURE = 1 / 3


def warnings_of(outcomes: Sequence[Outcome], found: Sequence[str], output: Path) -> list[str]:
    """Warnings of all stations. Those about finding the stations (`found`), which every station repeats, are listed once."""
    shared = [f"photos: {warning}" for warning in found]
    warnings = list(shared)
    for outcome in outcomes:
        name = outcome["station"]
        if outcome["status"] != "done":
            warnings += left_out([outcome])
            continue
        own = Workspace(output / "stations" / name).quality["warnings"]
        warnings += [f"{name}: {warning}" for warning in own if warning not in shared]
    return warnings


def left_out(outcomes: Sequence[Outcome]) -> list[str]:
    """A warning about each station that is not in the surface."""
    return [
        f"{outcome['station']}: is not in the surface: {outcome['reason']}"
        for outcome in outcomes
        if outcome["status"] != "done"
    ]


def doubts_of_object(
    rows: Sequence[Mapping[str, Any]],
    closed: bool,
    thing: Object,
    compared: Mapping[str, Any] | None,
    bare: Sequence[str],
) -> list[str]:
    """Warnings about the object's surface itself. rows: `stations` of quality.json. closed: whether the mesh is closed. bare: warnings
    about clouds.
    """
    warnings = [f"object: {warning}" for warning in bare]
    if thing.closed and not closed:
        warnings.append("object: the mesh was to be closed, but it has open edges")
    if compared is not None and compared["status"] != "done":
        # The page shows the warnings, and must not reveal the scan's path on this computer.
        warnings.append(f"object: is not compared with {Path(compared['file']).name}: {compared['status']}")
    return warnings + doubts_of_stations(rows)


def doubts_of_stations(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Warnings about stations in the surface that add nothing to it, or that the others do not confirm. rows: `stations` of quality.json."""
    done = [row for row in rows if row["status"] == "done"]
    warnings = []
    for row in done:
        name, met = row["station"], row["agreement"]
        off, contradicted = met["rms_ratio"], met["contradicted_fraction"]
        if row["unsure_fraction"] > _MOST_UNSURE:
            warnings.append(
                f"object: {name}: {100 * row['unsure_fraction']:.0f} % of its surface is left out, because its standard deviation is above "
                f"{row['max_sigma_gsd']:.3g} GSD (object.max_sigma_gsd)"
            )
        if row["seen_fraction"] == 0:
            warnings.append(
                f"object: {name}: no part of the mesh is its surface: it is less certain than object.max_sigma_gsd allows, or other "
                "stations see its places better or contradict it"
            )
        elif contradicted is None and len(done) > 1:
            warnings.append(
                f"object: {name}: no other station has a surface where it has its own, so that nothing checks its place; if others see the "
                "same places, a pose or a scale is wrong"
            )
        elif off is not None and off > _WORTH_A_WARNING:
            warnings.append(
                f"object: {name}: the surfaces of other stations lie {off:.2g} standard deviations (RMS) off its own, expected 1: are its "
                "pose and its scale right?"
            )
        if contradicted is not None and contradicted > _MOST_CONTRADICTED:
            warnings.append(
                f"object: {name}: {100 * contradicted:.0f} % of its comparisons with other stations are contradictions: one of the two sees "
                "through the surface of the other; one of them is wrong there (red in the maps of agreement)"
            )
    return warnings


def doubted_stations(quality: Mapping[str, Any]) -> list[str]:
    """Confidence, with its reasons, of each station in the surface whose confidence is not high."""
    done = [row for row in quality["stations"] if row["status"] == "done" and row["confidence"] != "high"]
    return [f"{row['station']}: confidence {row['confidence']}: {row['reasons']}" for row in done]
