"""Registration of the later surface to the earlier one by the parts that did not change between them.

The first, rough registration uses features (SIFT, Lowe 2004) of the pictures and of relief shadings, which do not depend on the
light. Point-to-plane ICP with robust weights follows (`malus.assess.compare`), then twice more without the blocks of pixels that changed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import assess
from malus._core import FusedSurface
from malus._extra import extra
from malus._robust import robust_spread
from malus.camera import Camera
from malus.errors import DataError
from malus.exports.exporter import Exporter
from malus.options import Options
from malus.raster import reduced, sample, step_for
from malus.relief import flattened, hillshade

Floats = NDArray[np.float64]
#: Side of the blocks of pixels that are classified as stable or changed, and the distance from the median, in robust standard
#: deviations of all blocks, from which a block counts as changed.
_BLOCK_PX = 16
_APART = 3.0
#: Number of matches that must agree on one motion, and their largest reprojection error (pixels of the later view).
_LEAST_MATCHES = 12
_AGREEMENT_PX = 4.0
_RATIO = 0.8
#: Longest side of the pictures in which features are found: memory grows with the pixels, time with the square of the features. The
#: place that they give is rough anyway.
_FEATURES_SIDE_PX = 3000
#: Share of the later surface that must lie near the earlier one.
_LEAST_COMPARED = 0.1


@dataclass(frozen=True)
class Motion:
    """x_before = rotation @ x_after + translation, world frames, unit of the earlier station."""

    rotation: Floats
    translation: Floats

    def apply(self, points: Floats) -> Floats:
        """Points (…×3) of the later frame, in the earlier frame."""
        return np.asarray(points @ self.rotation.T + self.translation, dtype=np.float64)

    def after(self, first: Motion) -> Motion:
        """The motion that applies `first` and then this motion."""
        return Motion(self.rotation @ first.rotation, self.rotation @ first.translation + self.translation)

    def moved(self, surface: FusedSurface) -> FusedSurface:
        """A surface of the later frame, in the earlier frame: only the pose of its camera changes."""
        camera = surface.camera
        rotation, translation = camera.pose()
        turned = rotation @ self.rotation.T
        pose = turned, translation - turned @ self.translation
        moved = Camera("PINHOLE", camera.width, camera.height, [camera.fx, camera.fy, camera.cx, camera.cy], *pose)
        return FusedSurface(surface.depth, surface.normals, surface.sigma, moved)


@dataclass(frozen=True)
class Registration:
    """The registration of the later surface to the earlier one.

    by: "features" (features, then ICP), "frames" (ICP that starts from the given frames) or "none" (nothing was moved). matches:
    number of features that agree. size: length on the later surface over the same length on the earlier one, from the features.
    error: one robust standard deviation of the median distances of blocks of pixels where nothing changed, station unit. offset: median
    of these distances, positive if the later surface lies in front. stable_fraction: share of the later surface that counts as unchanged.
    """

    motion: Motion
    by: str
    matches: int
    size: float | None
    error: float
    offset: float
    stable_fraction: float


def register(before: Exporter, after: Exporter, *, same_frame: bool, threads: int) -> Registration:
    """Find the motion of the later surface; DataError if the surfaces cannot be registered.

    same_frame: both surfaces are in one frame already; nothing is moved, only the error is measured.
    """
    matches, size, by = 0, None, "none"
    motion = Motion(np.eye(3), np.zeros(3))
    if not same_frame:
        rough = _from_features(before, after)
        by = "frames" if rough is None else "features"
        if rough is not None:
            motion, matches, size = rough
    mesh = before.mesh()
    options = Options()
    options.assess.alignment = "none" if same_frame else "rigid"
    gsd = float(before.workspace.quality["gsd"])
    depth = after.surface.depth.copy()
    # Two of the three rounds leave out the blocks that changed.
    for _ in range(3):
        surface = FusedSurface(depth, after.surface.normals, after.surface.sigma, after.surface.camera)
        found = assess.compare(
            motion.moved(surface), mesh.vertices, gsd, triangles=mesh.triangles, options=options, threads=threads
        )
        # A motion that has not converged is not an error: the next round continues it, and the blocks show how good it is.
        if found["status"] == "no pixel near the reference" or found["compared_fraction"] < _LEAST_COMPARED:
            raise DataError(
                f"{after.workspace.folder}: its surface does not lie on that of {before.workspace.folder} "
                f"({100 * found['compared_fraction']:.0f} % lies near it, {matches} features agree), expected two surfaces of the same object; "
                "if their frames differ, their pictures must resemble each other"
            )
        step = found["reference_from_surface"]
        motion = Motion(np.array(step["rotation"]).reshape(3, 3), np.array(step["translation"])).after(motion)
        stable, error, offset = _stable(found["distance"])
        depth[~stable] = np.nan
    share = np.isfinite(depth).sum() / np.isfinite(after.surface.depth).sum()
    return Registration(motion, by, matches, size, error, offset, float(share))


def _stable(distance: NDArray[np.float32]) -> tuple[NDArray[np.bool_], float, float]:
    """Pixels of blocks whose median distance is near the median of all blocks, and robust σ and median of the blocks' medians."""
    height, width = distance.shape
    rows, columns = -(-height // _BLOCK_PX), -(-width // _BLOCK_PX)
    padded = np.full((rows * _BLOCK_PX, columns * _BLOCK_PX), np.nan)
    padded[:height, :width] = distance
    blocks = padded.reshape(rows, _BLOCK_PX, columns, _BLOCK_PX).swapaxes(1, 2).reshape(rows, columns, -1)
    enough = np.isfinite(blocks).sum(-1) > _BLOCK_PX**2 // 4
    if not enough.any():
        return np.zeros(distance.shape, bool), float("nan"), float("nan")
    medians = np.full((rows, columns), np.nan)
    medians[enough] = np.nanmedian(blocks[enough], axis=1)
    middle = float(np.median(medians[enough]))
    spread = robust_spread(medians[enough] - middle)
    stable = np.abs(medians - middle) <= _APART * spread
    pixels = np.kron(stable, np.ones((_BLOCK_PX, _BLOCK_PX), bool))[:height, :width]
    return pixels, spread, middle


def _step_of(exporter: Exporter) -> int:
    """Side of the blocks of pixels over which a view is averaged to find features."""
    return step_for(exporter.surface.depth.shape, _FEATURES_SIDE_PX)


def _pictures(exporter: Exporter, step: int) -> list[NDArray[np.uint8]]:
    """The object's picture in gray, and relief shadings from two light directions, averaged over step × step pixels."""
    gsd = float(exporter.workspace.quality["gsd"])
    relief = flattened(reduced(exporter.surface.depth, step))
    shades = [hillshade(relief, gsd * step, azimuth) for azimuth in (315, 45)]
    return [
        reduced(exporter.picture().mean(-1, dtype=np.float32), step).astype(np.uint8),
        *(np.rint(255 * np.nan_to_num(shade)).astype(np.uint8) for shade in shades),
    ]


def _matched(before: Exporter, after: Exporter, cv2: Any) -> tuple[Floats, Floats]:
    """Pixels (N×2 each) that look alike in both views."""
    sift, matcher = cv2.SIFT_create(), cv2.BFMatcher(cv2.NORM_L2)
    steps = [_step_of(exporter) for exporter in (before, after)]
    known = [
        np.where(np.isfinite(reduced(exporter.surface.depth, step)), 255, 0).astype(np.uint8)
        for exporter, step in zip((before, after), steps, strict=True)
    ]
    here, there = [np.empty((0, 2))], [np.empty((0, 2))]
    for one, other in zip(_pictures(before, steps[0]), _pictures(after, steps[1]), strict=True):
        points, described = sift.detectAndCompute(one, known[0])
        others, described_too = sift.detectAndCompute(other, known[1])
        if described is None or described_too is None or min(len(points), len(others)) < 2:
            continue
        pairs = matcher.knnMatch(described, described_too, k=2)
        good = [first for first, second in pairs if first.distance < _RATIO * second.distance]
        here.append(np.array([points[match.queryIdx].pt for match in good]).reshape(-1, 2))
        there.append(np.array([others[match.trainIdx].pt for match in good]).reshape(-1, 2))
    # From pixels of the pictures to those of the views.
    first, second = ((np.concatenate(at) + 0.5) * step - 0.5 for at, step in zip((here, there), steps, strict=True))
    return first, second


def _from_features(before: Exporter, after: Exporter) -> tuple[Motion, int, float] | None:
    """Motion, number of features that agree on it, and size of the later surface over that of the earlier one; None with too few features."""
    cv2 = extra("cv2", "opencv-contrib-python-headless", "malus compare", "compare")
    here, there = _matched(before, after, cv2)
    points, points_after = (sample(one.workspace.points(), at) for one, at in ((before, here), (after, there)))
    usable = np.isfinite(points).all(-1) & np.isfinite(points_after).all(-1)
    points, points_after, there = points[usable], points_after[usable], there[usable]
    if len(points) < _LEAST_MATCHES:
        return None
    # About their middle, because SQPNP squares coordinates: in a national frame (meters from the equator) nothing would be left.
    middle = points.mean(0)
    camera = after.workspace.camera
    lens = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
    cv2.setRNGSeed(1)
    found, _, _, inliers = cv2.solvePnPRansac(
        points - middle, there, lens, None, iterationsCount=5000, reprojectionError=_AGREEMENT_PX * _step_of(after), confidence=0.9999,
        flags=cv2.SOLVEPNP_SQPNP,
    )  # fmt: skip
    if not found or inliers is None or len(inliers) < _LEAST_MATCHES:
        return None
    chosen = inliers.ravel()
    source, target = points_after[chosen], points[chosen]
    fitted, size = cv2.estimateAffine3D(source - source.mean(0), target - target.mean(0), force_rotation=True)
    rotation = np.asarray(fitted[:, :3], dtype=np.float64)
    return Motion(rotation, target.mean(0) - rotation @ source.mean(0)), len(chosen), 1 / float(size)
