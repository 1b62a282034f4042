"""Scale of the model from the known distances of a station file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus.camera import Camera
from malus.columns import number as readable
from malus.errors import DataError, InputError
from malus.options import Options
from malus.photogrammetry.diagnosis import NO_SIZE, Log, listed
from malus.photogrammetry.photos import Photo, read_gray, to_bytes

#: Residuals of more standard deviations are likely mistakes.
_SUSPICIOUS = 4.0
#: A larger standard deviation of the size, as a share of it, is an error if marks and distances contradict each other.
_UNKNOWN_SIZE = 0.02

Mark = tuple[str, float, float]
#: Target id → marks of the target in the photos, for one dictionary.
Targets = dict[int, list[Mark]]


@dataclass(frozen=True)
class _Ends:
    """Marks of both ends of one distance, and their standard deviation."""

    a: list[Mark]
    b: list[Mark]
    sigma_px: float


def find_targets(photos: Sequence[Photo], dictionary: str) -> Targets:
    """Coded targets of a dictionary in every photo."""
    targets: Targets = {}
    for photo in photos:
        image: NDArray[np.uint8] = to_bytes(read_gray(photo.path), gamma=1.0)
        found = _core.detect_targets(image, dictionary)
        times = Counter(number for number, _, _ in found)
        for number, x, y in found:
            # Of two places in one photo at most one is right: texture can look like a target, and prints may be there twice.
            if times[number] == 1:
                targets.setdefault(number, []).append((photo.name, x, y))
    return targets


def require_scale(said: Mapping[str, Any], photos: Sequence[str]) -> None:
    """Check that the known distances of `Station.describe` can give a size to these photos, before hours go into matching the photos.

    Raises InputError if no distance that is not held out can be measured: marks in files that are not among the photos, such as excluded
    ones, do not count.
    """
    bars, known = said["scale"], set(photos)
    if not bars or any(bar["targets"] or _is_marked(bar, known) for bar in bars if not bar["check"]):
        return
    others = sorted({mark["image"] for bar in bars for mark in [*bar["a"], *bar["b"]]} - known)
    raise InputError(
        f"{said['path']}: [[scale]]: no distance without check = true is marked at both ends in two photos or more, expected one"
        + (f"; marks in {listed(others)} do not count, which are not among the photos" if others else "")
    )


def _is_marked(bar: Mapping[str, Any], photos: Container[str]) -> bool:
    """Whether both ends of a distance are marked in two photos or more."""
    return all(sum(mark["image"] in photos for mark in bar[end]) > 1 for end in "ab")


def _ends(bar: Mapping[str, Any], found: Mapping[str, Targets], options: Options) -> _Ends:
    if bar["targets"]:
        targets = found[bar["targets_dictionary"]]
        a, b = (targets.get(number, []) for number in bar["targets"])
        return _Ends(a, b, options.photos.target_sigma_px)
    a, b = ([(mark["image"], mark["x"], mark["y"]) for mark in bar[end]] for end in "ab")
    return _Ends(a, b, options.photos.mark_sigma_px)


def adjust_scale(
    bars: Sequence[Mapping[str, Any]],
    photos: Sequence[Photo],
    cameras: Mapping[str, Camera],
    options: Options,
    log: Log,
) -> dict[str, Any] | None:
    """Scale (station units per model unit) from the [[scale]] tables of a station, with residuals and standard deviations.

    cameras: registered photos by name, in the model's frame. Distances that cannot be measured are left out with a
    warning. None when the station has no [[scale]]; DataError when none of its distances can be measured, InputError when marks and
    distances contradict each other so much that the size is not known to two percent.
    """
    if not bars:
        log("warning", NO_SIZE)
        return None
    dictionaries = {str(bar["targets_dictionary"]) for bar in bars if bar["targets"]}
    found = {name: find_targets(photos, name) for name in sorted(dictionaries)}
    names = sorted(cameras)
    index = {name: number for number, name in enumerate(names)}
    distances, reasons = [], []
    for number, bar in enumerate(bars, 1):
        ends = _ends(bar, found, options)
        marks = [[(index[n], x, y, ends.sigma_px) for n, x, y in end if n in index] for end in (ends.a, ends.b)]
        if min(len(end) for end in marks) < 2:
            reasons.append(_reason(number, bar, ends, index))
            log("warning", reasons[-1] + "; this distance is left out")
            continue
        sigma = max(options.photos.distance_sigma_relative, 1e-9) * bar["distance"]
        distances.append((f"[[scale]] {number}", bar["distance"], sigma, *marks, bar["check"]))
    if all(distance[-1] for distance in distances):
        why = ("; " + "; ".join(reasons)) if reasons else ""
        raise DataError(f"[[scale]]: no distance determines the scale, expected one without check = true{why}")
    views = [(name, cameras[name].values()) for name in names]
    result: dict[str, Any] = _core.adjust_scale(views, distances)
    _require_fit(result)
    _warn(result, log)
    return result


def _reason(number: int, bar: Mapping[str, Any], ends: _Ends, registered: Mapping[str, int]) -> str:
    if bar["targets"]:
        seen = {
            target: [name for name, _, _ in end if name in registered]
            for target, end in zip(bar["targets"], (ends.a, ends.b), strict=True)
        }
        text = ", ".join(f"target {target} in {len(photos)} photos" for target, photos in seen.items())
        return f"[[scale]] {number}: found {text} with a position, expected each in two or more, once in each photo"
    missing = sorted({name for name, _, _ in [*ends.a, *ends.b] if name not in registered})
    return f"[[scale]] {number} is marked in photos without a position ({listed(missing)}), fewer than two are left at an end"


def _disagree(result: Mapping[str, Any]) -> bool:
    return bool(result["redundancy"] > 0 and result["unit_weight"] > _SUSPICIOUS)


def _worst_mark(result: Mapping[str, Any]) -> str:
    worst = max(result["distances"], key=lambda fit: float(fit["worst_px"]))
    return f"the worst mark is that of {worst['name']} in {worst['worst_image']}, {worst['worst_px']:.1f} px off"


def _require_fit(result: Mapping[str, Any]) -> None:
    share = result["sigma"] / result["scale"]
    if _disagree(result) and share > _UNKNOWN_SIZE:
        raise InputError(
            f"[[scale]]: marks and distances do not fit, so that the size is known to {100 * share:.2g} % only; "
            f"{_worst_mark(result)}. Is the same point marked in every photo, in a and in b, and is each distance in the station's unit?"
        )


def _warn(result: Mapping[str, Any], log: Log) -> None:
    if result["status"] != "converged":
        log(
            "warning",
            "[[scale]]: the size was still changing when its adjustment ended; are all marks where they should be?",
        )
    if _disagree(result):
        log(
            "warning",
            f"[[scale]]: marks and distances disagree by {result['unit_weight']:.1f} times their standard deviation; "
            + _worst_mark(result),
        )
    for fit in result["distances"]:
        if abs(fit["residual"]) > _SUSPICIOUS * fit["sigma"]:
            log(
                "warning",
                f"{fit['name']}: {readable(fit['adjusted'], 6)} in the model, {readable(fit['distance'], 6)} given, "
                f"{abs(fit['residual']) / fit['sigma']:.1f} standard deviations apart",
            )
