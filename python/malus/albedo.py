"""The object's own color: what it would look like under even light, without highlights and without shading.

There are three steps. First, the mirrored light, known from its polarization (fused/mirrored.tif), is subtracted. Second, a light is
fitted to the remaining image: a lamp, and a sky that may be brighter on one side. The fit makes the albedo of neighboring pixels
independent of their slopes. Third, the image is divided by the shading under that light. The scale of the albedo is free, because the
strength of the light is unknown. Cast shadows and light reflected between parts of the object are not removed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from malus._robust import robust_spread
from malus.errors import DataError
from malus.workspace import Workspace

Floats = NDArray[np.float64]
#: Number of pixel pairs to which the light is fitted, their largest distance along rows and columns, and steps of the fit.
_PAIRS, _FARTHEST_PX, _STEPS = 20000, 24, 25
#: With fewer pixels no light is fitted: the shading is then taken as even.
_LEAST_PIXELS = 400
#: Lower limit of the shading, as a share of its median, so that noise in shadows is not amplified.
_LEAST_SHADING = 0.2
#: Standard deviation of the sky's unevenness, in strengths of the lamp.
_SKY_SIGMA = 0.3


@dataclass(frozen=True)
class Shading:
    """Light on the object. lamp: direction times strength (camera frame: x right, y down, z forward); sky: even part, and its gradient (3).

    Only the ratio of lamp and sky is determined, not their common strength.
    """

    lamp: Floats
    sky: Floats

    def on(self, normals: Floats) -> Floats:
        """Shading of unit normals (…×3, camera frame)."""
        direct = np.maximum(normals @ self.lamp, 0)
        return np.asarray(direct + np.maximum(self.sky[0] + normals @ self.sky[1:], 0.02))


def fit_shading(body: Floats, normals: Floats) -> Shading:
    """The light under which neighbors of different slopes have the most similar albedo.

    body: H×W, diffusely reflected light, NaN = none. normals: H×W×3.
    The residuals are differences of logarithms between pixels a few pixels apart. Gauss–Newton with Cauchy weights: pairs across a
    border between two colors of the object are outliers.
    """
    usable = np.isfinite(body) & np.isfinite(normals).all(-1) & (body > 0)
    if usable.sum() < _LEAST_PIXELS:
        return Shading(np.zeros(3), np.array([1.0, 0, 0, 0]))
    first, second = _pairs(usable)
    target = np.log(body[first]) - np.log(body[second])
    sides = normals[first], normals[second]

    def predicted(x: Floats) -> Floats:
        shading = Shading(x[:3], x[3:])
        one, other = (np.log(np.maximum(shading.on(side), 1e-3)) for side in sides)
        return np.asarray(one - other)

    x = _robust_fit(predicted, target, np.concatenate([_first_lamp(body, normals), [0.3, 0, 0, 0]]))
    return Shading(x[:3], x[3:])


def _pairs(known: NDArray[np.bool_]) -> tuple[tuple[NDArray[np.int64], ...], tuple[NDArray[np.int64], ...]]:
    """Indices of pairs of known pixels a few pixels apart; a fixed random seed makes them the same for the same mask."""
    random = np.random.default_rng(7)
    rows, columns = np.nonzero(known)
    chosen = random.integers(0, len(rows), 3 * _PAIRS)
    apart = random.integers(-_FARTHEST_PX, _FARTHEST_PX + 1, (2, 3 * _PAIRS))
    other_rows, other_columns = rows[chosen] + apart[0], columns[chosen] + apart[1]
    inside = (other_rows >= 0) & (other_rows < known.shape[0]) & (other_columns >= 0) & (other_columns < known.shape[1])
    inside[inside] = known[other_rows[inside], other_columns[inside]]
    kept = np.flatnonzero(inside)[:_PAIRS]
    return (rows[chosen[kept]], columns[chosen[kept]]), (other_rows[kept], other_columns[kept])


def _robust_fit(predicted: Callable[[Floats], Floats], target: Floats, x: Floats) -> Floats:
    """Damped Gauss–Newton with Cauchy weights; the length of the lamp's vector is held near 1, and the sky near even."""
    prior = np.array([0, 0, 0, 1 / 2.0, *[1 / _SKY_SIGMA] * 3])
    middle = np.array([0, 0, 0, 0.3, 0, 0, 0])
    damping = 1e-3
    for _ in range(_STEPS):
        now = predicted(x)
        residual = target - now
        spread = robust_spread(residual) + 1e-9
        weight = 1 / (1 + (residual / (2.4 * spread)) ** 2)
        step = 1e-4
        jacobian = np.stack([(predicted(x + step * axis) - now) / step for axis in np.eye(len(x))], -1)
        normal = (jacobian * weight[:, None]).T @ jacobian / spread**2
        right = (jacobian * weight[:, None]).T @ residual / spread**2
        # The common scale of lamp and sky is free: hold the lamp's length.
        scale = np.concatenate([x[:3], np.zeros(4)])
        normal += np.diag(prior**2 + 1e-6 * (1 + np.trace(normal))) + 1e6 * np.outer(scale, scale) / max(
            float(scale @ scale), 1e-9
        )
        right -= prior**2 * (x - middle)
        change = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), right)
        new = x + change
        before, after = (np.log1p((left / (2.4 * spread)) ** 2).sum() for left in (residual, target - predicted(new)))
        if after <= before:
            x, damping = new, damping / 3
            if np.abs(change).max() < 1e-4:
                break
        else:
            damping *= 10
    return x


def albedo_of(workspace: Workspace) -> NDArray[np.float32]:
    """Albedo of a finished workspace, up to one factor; H×W, or H×W×3 if it was taken in color, NaN where there is no surface.

    DataError for a surface without a reflection model (`--fusion grid`), and for bare metal: their highlights cannot be separated
    from their color.
    """
    mirrored = workspace.mirrored_share()
    if mirrored is None:
        raise DataError(
            f"{workspace.folder}: nothing tells highlights from the object's color; expected a workspace of --fusion refined, "
            "and an object that is not bare metal"
        )
    color = workspace.color()
    found = diffuse_albedo(
        color.reshape(*color.shape[:2], -1),
        workspace.raster("fused/normals.tif"),
        mirrored=mirrored,
    )
    return found.reshape(color.shape)


def diffuse_albedo(
    picture: NDArray[np.floating],
    normals: NDArray[np.floating],
    *,
    mirrored: NDArray[np.floating] | None = None,
) -> NDArray[np.float32]:
    """Albedo up to one factor, H×W×C float32, as bright in the median as the picture; NaN where there is no surface.

    picture: H×W×C, linear. normals: H×W×3, unit, camera frame, NaN = none. mirrored: H×W, mirrored share of the light; the same
    amount is subtracted from all channels, because a mirror image has the color of the light.
    Cast shadows are not removed.
    """
    color = np.asarray(picture, dtype=np.float64)
    normal = np.asarray(normals, dtype=np.float64)
    brightness = color.mean(-1)
    known = np.isfinite(normal).all(-1) & np.isfinite(brightness)
    if mirrored is not None:
        share = np.where(np.isfinite(mirrored), mirrored, 0)
        color = np.maximum(color - (share * brightness)[..., None], 0.02 * color)
    body = np.where(known, color.mean(-1), np.nan)
    light = fit_shading(body, normal).on(normal)
    middle = float(np.nanmedian(light[known]))
    albedo = color * (middle / np.maximum(light, _LEAST_SHADING * middle))[..., None]
    albedo[~known] = np.nan
    return albedo.astype(np.float32)


def _first_lamp(body: Floats, normals: Floats) -> Floats:
    """Initial direction of the lamp: the one in which brightness grows with the slope, kept on the viewer's side of the object."""
    known = np.isfinite(body) & np.isfinite(normals).all(-1)
    rows = normals[known][:: max(1, int(known.sum()) // 50000)]
    values = body[known][:: max(1, int(known.sum()) // 50000)]
    solution = np.linalg.lstsq(np.column_stack([rows, np.ones(len(rows))]), values, rcond=None)[0][:3]
    solution[2] = min(float(solution[2]), -0.3 * float(np.linalg.norm(solution)) - 1e-9)
    return np.asarray(solution / np.linalg.norm(solution))
