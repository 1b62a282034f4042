"""What the files of an object's surface state about it: catalog entries, unit, pixel size, and how far its stations can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from malus import _core
from malus.batch import Outcome
from malus.lengths import shown
from malus.object.definition import Object
from malus.workspace import Workspace


def said_of_object(
    thing: Object, done: Sequence[Outcome], output: Path, gsd: float, doubts: Sequence[str]
) -> dict[str, str]:
    """One line for each statement, as in the files of a single station (malus.trust.said_of).

    Catalog entries are those of the stations' [object] in which no two stations differ. An object has no confidence of its own: that of
    each station is stated, with its reasons, and what may be wrong with the whole (doubts). gsd: median pixel of the stations (done), in
    the object's unit.
    """
    catalogs = [Workspace(output / "stations" / outcome["station"]).quality.get("object") or {} for outcome in done]
    entries: dict[str, set[str]] = {}
    for catalog in catalogs:
        for key, value in catalog.items():
            if line := " ".join((value or "").split()):
                entries.setdefault(key, set()).add(line)
    agreed = {key: next(iter(values)) for key, values in entries.items() if len(values) == 1}
    told = {
        f"confidence of {outcome['station']}": " ".join(
            f"{outcome['figures'].get('confidence', '')} {outcome['figures'].get('reasons', '')}".split()
        )
        for outcome in done
    }
    return {
        "title": thing.name,
        **agreed,
        "unit": thing.unit,
        "pixel": shown(gsd, thing.unit, 4),
        "frame": "world",
        **told,
        **{f"warning {k}": " ".join(doubt.split()) for k, doubt in enumerate(doubts, start=1)},
        "made_by": f"Malus {_core.version}",
    }
