"""Messages about what went wrong with the photos and what to do next."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from malus.errors import DataError
from malus.photogrammetry.database import connected_groups

#: Receives a level (info, warning) and a message.
Log = Callable[[str, str], None]


def silent(*_: object) -> None:
    """The default for what receives progress or messages."""


#: Fewer features than this do not link a photo to others reliably.
FEW_FEATURES = 200
#: With a smaller relief (spread of the points across their plane over the spread along it) the focal length cannot be determined.
FLAT_RELIEF = 0.02
NO_SIZE = (
    "there is neither [[scale]] nor [[control]]: the result is in an arbitrary unit, shape without size; give the distance of two "
    "marked points"
)
_LISTED = 6

_OVERLAP = (
    "photograph from more positions, so that neighboring photos show the same part from directions 10° to 30° apart, and "
    "surround a shiny or plain object with texture (newspaper, a printed pattern)"
)

_MORE_INSIDE = (
    "only features inside the masks count on a turntable: come closer and use sharp, well exposed photos, or let the object stand "
    "on textured ground and move the camera about it"
)


def listed(names: Sequence[str]) -> str:
    """Names for a message, at most _LISTED of them and the number of the others."""
    more = len(names) - _LISTED
    return ", ".join(names[:_LISTED]) + (f" and {more} more" if more > 0 else "")


def too_few_photos(count: int, expected: int, others: str) -> str:
    """Message for a folder with too few photos. others: images of other formats in it, empty without any."""
    return (
        f"[photos] has {count} photo{'s' * (count != 1)}, expected at least {expected}, better 8 to 20, from different "
        "directions around the station's; see docs/capture.md"
        + (f"; {others} cannot be read as photos, expected PNG, TIFF or JPEG" if others else "")
    )


def check_features(counts: Mapping[str, int], log: Log, *, inside_masks: bool = False) -> None:
    """Warn of photos with few features; DataError if fewer than two photos have enough. inside_masks: others do not count."""
    few = [name for name, count in counts.items() if count < FEW_FEATURES]
    if len(counts) - len(few) < 2:
        raise DataError(
            f"[photos]: {len(few)} of {len(counts)} photos have fewer than {FEW_FEATURES} features ({listed(few)}): they "
            "are blurred, dark or show plain surfaces; "
            + (_MORE_INSIDE if inside_masks else "place texture around the object and use sharp, well exposed photos")
        )
    if few:
        log("warning", f"few features in {listed(few)}: blurred, dark or plain; these photos may stay without position")


def check_connections(names: Sequence[str], pairs: Mapping[tuple[str, str], int]) -> None:
    """DataError if no three photos are linked by matches."""
    if len(connected_groups(names, pairs)[0]) < 3:
        raise DataError(
            f"[photos]: no three of the {len(names)} photos show enough of the same surface ({len(pairs)} pairs match); "
            + _OVERLAP
        )


def check_mapping(
    mapping: Mapping[str, Any], names: Sequence[str], pairs: Mapping[tuple[str, str], int], log: Log, *, ran_out: bool
) -> None:
    """Warn of photos without matches to the others, of others without position, and of models that are not connected, once of each photo;
    DataError if there is no model.

    ran_out: whether the search for a model ended for lack of time.
    """
    registered = mapping["models"][mapping["best"]] if mapping["best"] is not None else []
    groups = connected_groups(names, pairs)
    linked = next((group for group in groups if not set(group).isdisjoint(registered)), groups[0])
    for group in groups:
        if group is not linked:
            log(
                "warning",
                f"{listed(group)}: nothing in common with the other {len(linked)} photos, left out; if the object is shown, "
                "photograph the views in between",
            )
    if mapping["best"] is None:
        raise DataError(_no_model(mapping, names, pairs, ran_out=ran_out))
    pieces = [model for name, model in mapping["models"].items() if name != mapping["best"]]
    for piece in pieces:
        others = [name for name in piece if name not in registered and name in linked]
        if others:
            log(
                "warning",
                f"the photos make two models that do not hold together; {listed(others)} are left out of the larger "
                f"({len(registered)} photos): photograph the views between the two, with overlap to both",
            )
    in_pieces = {name for piece in pieces for name in piece}
    missing = [name for name in names if name in linked and name not in registered and name not in in_pieces]
    if missing:
        log(
            "warning",
            f"no position was found for {listed(missing)}: too few matches with the other photos; add photos from "
            "directions in between",
        )


def _no_model(
    mapping: Mapping[str, Any], names: Sequence[str], pairs: Mapping[tuple[str, str], int], *, ran_out: bool
) -> str:
    start = f"[photos]: {len(pairs)} pairs of the {len(names)} photos match, but no first pair fixes the geometry"
    if mapping["assumed"]:
        start += f", with {mapping['assumed']} assumptions on the unknown focal length"
    if ran_out:
        start += ". The search ran out of time: on a slow or busy machine a larger photos.search_limit_s may find one"
    if mapping["assumed"]:
        return (
            f"{start}. Usual causes: a flat scene or a "
            "long lens, with which the focal length cannot be told from the distance. Give the calibrated lens as "
            "[photos] camera = { model, width, height, params }, or photos with EXIF focal length, or photograph the object "
            "on a tilted or deeper, textured scene from directions up to 40° apart"
        )
    if mapping["calibrated"]:
        lens, advice = (
            "a calibration that does not belong to them (another focal length or focus)",
            "Check [photos] camera",
        )
    else:
        lens = "an EXIF focal length that is not theirs (cropped photos, an adapter)"
        advice = "Give the calibrated lens as [photos] camera = { model, width, height, params }"
    return f"{start}. Usual causes: all photos from nearly one direction, or {lens}. {advice}; {_OVERLAP}"


def station_not_registered(matches: Mapping[str, int], least: int) -> str:
    """Message for a station whose image could not be placed among the photos."""
    best = sorted(matches.items(), key=lambda item: -item[1])[:3]
    found = ", ".join(f"{name}: {count}" for name, count in best) or "none with any"
    return (
        f"the station's image could not be placed among the photos (matches, best first: {found}; at least {least} are "
        "needed with several photos). Take a few photos near the station's direction and distance, with the same texture "
        "around the object in view, and check that [camera] is the polarized images' own calibration"
    )


def unknown_focal_on_flat_scene(relief: float) -> str:
    """Message for a self-calibration on a scene that is too flat to determine the focal length."""
    return (
        f"[photos]: the scene is flat (depth {100 * relief:.1f} % of its extent) and the photos' camera is not calibrated: "
        "focal length and distance cannot be told apart, and the model would be bent or stretched. Give the calibrated lens "
        "as [photos] camera = { model, width, height, params }, or photograph the object with something deeper around it "
        "(boxes, a tilted board with texture) from directions up to 40° apart"
    )
