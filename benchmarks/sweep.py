"""Surface sweep on rendered stations with true poses: errors from the truth, compared with OpenCV's SGBM over rectified pairs.

    python benchmarks/sweep.py SCENE… [--threads N] [--enlarge N] [--pairs 8] [--no-sgbm] [--set sweep.key=value]

SCENE: a folder written by rendered/renderer/render.py, with gt/, gt_sparse/ (poses only), pol/lownoise and views/. The points that the
sweep starts from are SIFT matches of all pairs of photos, triangulated with the true poses. Needs
`pip install opencv-python-headless scipy`.

Figures, on the object 6 px inside its border: completeness; median, RMSE and bias of the depth's error in GSD (truth is
metric, nothing is aligned); `detail`: the error minus its Gaussian mean of sigma 8 px, as in the scoring; share of errors
within 2 sigma; seconds and peak MB.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
import warnings
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rendered_files import BORDER_PX, lowpass
from scipy import ndimage

import malus
from malus._robust import robust_spread

Array = NDArray[np.floating]


@dataclass
class Scene:
    name: str
    intensity: Array
    camera: malus.Camera
    views: list[tuple[Array, malus.Camera]]
    truth: Array
    mask: NDArray[np.bool_]
    gsd: float


def read_cameras(model: Path) -> dict[str, malus.Camera]:
    """Cameras of a COLMAP text model by image name."""
    lenses = {}
    for line in (model / "cameras.txt").read_text().splitlines():
        if line and not line.startswith("#"):
            number, name, width, height, *params = line.split()
            values = [float(p) for p in params]
            first = 1 if name.startswith("SIMPLE") or name == "RADIAL" else 2
            values[first] -= 0.5
            values[first + 1] -= 0.5
            lenses[number] = (name, int(width), int(height), values)
    cameras = {}
    for line in (model / "images.txt").read_text().splitlines():
        words = line.split()
        if len(words) == 10 and not line.startswith("#"):
            w, x, y, z = (float(q) for q in words[1:5])
            rotation = np.array([
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ])  # fmt: skip
            rotation = np.linalg.svd(rotation)[0] @ np.linalg.svd(rotation)[2]
            cameras[words[9]] = malus.Camera(*lenses[words[8]], rotation, [float(t) for t in words[5:8]])
    return cameras


def read_gray(path: Path) -> Array:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
    return np.float32(image) / np.iinfo(image.dtype).max


def load(folder: Path) -> Scene:
    meta = json.loads((folder / "meta.json").read_text())
    cameras = read_cameras(folder / "gt_sparse")
    polarized = sorted((folder / "pol" / "lownoise").glob("pol_*.png"))
    # Angles are evenly spaced, so the mean over them has no polarization.
    intensity = np.mean([read_gray(path) for path in polarized], axis=0)
    views = [(read_gray(folder / "views" / n), c) for n, c in sorted(cameras.items()) if n != "station.jpg"]
    gt = np.load(folder / "gt" / "depth_normal_mask.npz")
    mask = gt["mask"] & (gt["label"] == 1) if (gt["label"] == 1).any() else gt["mask"]
    return Scene(folder.name, intensity / intensity.max(), cameras["station.jpg"], views,
                 gt["depth"].astype(float), mask, meta["gsd_mm"])  # fmt: skip


def enlarged(scene: Scene, factor: int) -> Scene:
    """The scene interpolated to more pixels, to measure speed on large images; it gains no detail."""

    def image(values: Array, how: int = cv2.INTER_CUBIC) -> Array:
        return cv2.resize(values, None, fx=factor, fy=factor, interpolation=how)

    def camera(c: malus.Camera) -> malus.Camera:
        fx, fy, cx, cy = c.params
        params = [fx * factor, fy * factor, (cx + 0.5) * factor - 0.5, (cy + 0.5) * factor - 0.5]
        return malus.Camera(c.model, c.width * factor, c.height * factor, params, c.rotation, c.translation)

    return Scene(scene.name, image(scene.intensity), camera(scene.camera), [(image(i), camera(c)) for i, c in scene.views],
                 image(scene.truth, cv2.INTER_LINEAR), image(np.uint8(scene.mask), cv2.INTER_NEAREST) > 0,
                 scene.gsd / factor)  # fmt: skip


def projection(camera: malus.Camera) -> Array:
    fx, fy, cx, cy = camera.params
    rotation, translation = camera.pose()
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]) @ np.column_stack([rotation, translation])


def triangulated(scene: Scene, features: int = 4000) -> Array:
    """Points of SIFT matches between the photos (PINHOLE) whose reprojection errors are below 0.7 px."""
    sift = cv2.SIFT_create(features)
    found = [sift.detectAndCompute(np.uint8(255 * image), None) for image, _ in scene.views]
    points = []
    for i, (keys_a, texts_a) in enumerate(found):
        for j in range(i + 1, len(found)):
            keys_b, texts_b = found[j]
            if texts_a is None or texts_b is None:
                continue
            ab = [m for m, n in cv2.BFMatcher().knnMatch(texts_a, texts_b, k=2) if m.distance < 0.7 * n.distance]
            if len(ab) < 8:
                continue
            a = np.array([keys_a[m.queryIdx].pt for m in ab])
            b = np.array([keys_b[m.trainIdx].pt for m in ab])
            pa, pb = projection(scene.views[i][1]), projection(scene.views[j][1])
            x = cv2.triangulatePoints(pa, pb, a.T, b.T)
            errors = []
            for p, seen in ((pa, a), (pb, b)):
                y = p @ x
                errors.append(np.linalg.norm((y[:2] / y[2]).T - seen, axis=1))
            points.append((x[:3] / x[3]).T[np.maximum(*errors) < 0.7])
    return np.concatenate(points)


def figures(scene: Scene, depth: Array, sigma: Array | None = None) -> dict[str, float]:
    inner = np.zeros_like(scene.mask)
    inner[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = True
    mask = inner & ndimage.binary_erosion(scene.mask, np.ones((3, 3)), iterations=BORDER_PX, border_value=1)
    ok = mask & np.isfinite(depth)
    error = np.where(ok, (depth - scene.truth) / scene.gsd, 0.0)
    detail = (error - lowpass(error, ok))[ok]
    out = {
        "completeness": ok.sum() / mask.sum(),
        "median_gsd": np.median(np.abs(error[ok])),
        "rmse_gsd": np.sqrt((error[ok] ** 2).mean()),
        "bias_gsd": np.median(error[ok]),
        "over_1_gsd": (np.abs(error[ok]) > 1).mean(),
        "detail_rmse_gsd": np.sqrt((detail**2).mean()),
        "detail_mad_gsd": robust_spread(detail),
    }
    if sigma is not None:
        s = sigma[ok] / scene.gsd
        out["sigma_median_gsd"] = np.median(s)
        out["within_2_sigma"] = (np.abs(error[ok]) <= 2 * s).mean()
        out["within_1_sigma"] = (np.abs(error[ok]) <= s).mean()
    return {name: round(float(value), 4) for name, value in out.items()}


def sgbm_depth(scene: Scene, pairs: int) -> Array:
    """Median over rectified pairs of the station with its best photos, each by SGBM with eight paths (HH)."""
    station = np.uint8(255 * scene.intensity ** (1 / 2.2))
    shape = scene.truth.shape
    k0 = projection(malus.Camera("PINHOLE", shape[1], shape[0], scene.camera.params))[:, :3]
    r0, t0 = scene.camera.pose()
    center = -r0.T @ t0
    middle = np.median(scene.truth[scene.mask])
    target = center + r0[2] * middle

    def angle(camera: malus.Camera) -> float:
        r, t = camera.pose()
        a, b = center - target, -r.T @ t - target
        return float(np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))))

    chosen = sorted(scene.views, key=lambda view: abs(angle(view[1]) - 15))[:pairs]
    near, far = np.percentile(scene.truth[scene.mask], [0.5, 99.5]) + np.array([-5, 5]) * scene.gsd
    v, u = np.nonzero(scene.mask)
    seen = np.linalg.inv(k0) @ np.stack([u, v, np.ones_like(u)])[:, ::53].astype(float)
    maps = []
    for image, camera in chosen:
        k1 = projection(malus.Camera("PINHOLE", camera.width, camera.height, camera.params))[:, :3]
        r1, t1 = camera.pose()
        turn = r1 @ r0.T
        baseline = -turn.T @ (t1 - turn @ t0)  # the photo's center in the station's frame
        # Common orientation: x along the baseline from the station to the photo, z between the axes of both cameras.
        forward = np.array([0, 0, 1.0]) + turn[2]
        across = baseline / np.linalg.norm(baseline)
        forward -= across * (across @ forward)
        forward /= np.linalg.norm(forward)
        common = np.stack([across, np.cross(forward, across), forward])
        focal = k0[0, 0]
        # Each image just holds the object: the station's principal point follows from the object's outline, the photo's is
        # such that the farthest depth has no disparity.
        at = focal * (common @ seen)[:2] / (common @ seen)[2]
        center0 = 20 - at.min(1)
        size = tuple(int(n) for n in np.ceil(np.ptp(at, axis=1) + 40))
        z = np.stack([(common @ seen)[2] * depth for depth in (near, far)])
        disparity = focal * np.linalg.norm(baseline) / z  # x_station - x_photo, apart from the principal points
        shift = np.floor(disparity.min()) - 2
        count = int(np.ceil((disparity.max() - shift + 4) / 16)) * 16
        new0 = np.array([[focal, 0, center0[0]], [0, focal, center0[1]], [0, 0, 1]])
        new1 = new0 + np.array([[0, 0, shift], [0, 0, 0], [0, 0, 0]])
        # SGBM gives no disparity in `count` columns at the left.
        new0[0, 2] += count
        new1[0, 2] += count
        size = (size[0] + count, size[1])
        left = cv2.warpPerspective(station, new0 @ common @ np.linalg.inv(k0), size, flags=cv2.INTER_CUBIC)
        right = cv2.warpPerspective(np.uint8(255 * image), new1 @ common @ turn.T @ np.linalg.inv(k1), size,
                                    flags=cv2.INTER_CUBIC)  # fmt: skip
        matcher = cv2.StereoSGBM_create(0, count, 5, 8 * 25, 32 * 25, 1, 0, 5, 100, 2, cv2.STEREO_SGBM_MODE_HH)
        found = np.float32(matcher.compute(left, right)) / 16
        found[found < 0] = np.nan
        # Station pixel → rectified pixel → depth along the station's ray.
        v, u = np.indices(shape)
        rays = np.einsum("ij,jhw->ihw", common @ np.linalg.inv(k0), np.stack([u, v, np.ones_like(u)]).astype(float))
        x = np.float32(focal * rays[0] / rays[2] + new0[0, 2])
        y = np.float32(focal * rays[1] / rays[2] + new0[1, 2])
        d = cv2.remap(found, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"))
        maps.append(focal * np.linalg.norm(baseline) / (d + shift) / rays[2])
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return np.nanmedian(maps, axis=0)


def run(folder: Path, args: argparse.Namespace) -> None:
    scene = load(folder)
    points = triangulated(scene)
    if args.enlarge > 1:
        scene = enlarged(scene, args.enlarge)
    mega = scene.mask.sum() / 1e6
    options = malus.Options()
    for assignment in args.set:
        options.set(assignment)
    before = resource.getrusage(resource.RUSAGE_SELF)
    start = time.perf_counter()
    result = malus.stereo.sweep(scene.intensity, scene.camera, scene.views, points, mask=scene.mask, options=options,
                                threads=args.threads, log=lambda level, text: print(f"  {level}: {text}"))  # fmt: skip
    seconds = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_SELF)
    print(f"{scene.name}: {len(points)} points, {result.points_used} used, {result.views_used} views")
    print("  sweep", json.dumps(figures(scene, result.depth, result.sigma)))
    print(f"        {seconds:.2f} s, {after.ru_utime - before.ru_utime:.2f} CPU s, "
          f"{(after.ru_utime - before.ru_utime) / mega:.2f} CPU s/Mpx, "
          f"+{(after.ru_maxrss - before.ru_maxrss) / 1024:.0f} MB peak")  # fmt: skip
    for step in result.passes:
        print(f"        1/{step.reduction}: {step.offsets} offsets of {step.step_gsd:.2f} GSD, score {step.score:.3f}, "
              f"change {step.change_gsd:.3f} GSD, {step.seconds:.2f} s")  # fmt: skip
    if args.save:
        np.savez(f"{args.save}_{scene.name}.npz", depth=result.depth, sigma=result.sigma, confidence=result.confidence)
    if args.sgbm:
        cv2.setNumThreads(args.threads)
        before = resource.getrusage(resource.RUSAGE_SELF)
        start = time.perf_counter()
        depth = sgbm_depth(scene, args.pairs)
        seconds = time.perf_counter() - start
        after = resource.getrusage(resource.RUSAGE_SELF)
        print("  SGBM ", json.dumps(figures(scene, depth)))
        print(f"        {seconds:.2f} s, {after.ru_utime - before.ru_utime:.2f} CPU s, "
              f"{(after.ru_utime - before.ru_utime) / mega:.2f} CPU s/Mpx, "
              f"+{(after.ru_maxrss - before.ru_maxrss) / 1024:.0f} MB peak")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+", metavar="SCENE")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--pairs", type=int, default=8)
    parser.add_argument("--enlarge", type=int, default=1, help="every image to so many times its width")
    parser.add_argument("--sgbm", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--set", action="append", default=[], metavar="sweep.key=value")
    parser.add_argument("--save", metavar="PREFIX", help="write the rasters to PREFIX_scene.npz")
    args = parser.parse_args()
    for folder in args.scenes:
        run(folder, args)


if __name__ == "__main__":
    main()
