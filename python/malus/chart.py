"""Color correction with a ColorChecker photographed under the light of the station, with a stated color difference.

The chart is found by OpenCV's detector, or lies between four given corners. A matrix takes the camera's linear RGB to linear sRGB. The
remaining color differences are stated as CIEDE2000: for all patches, and for each patch with a matrix that was fitted without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core, raw
from malus._extra import extra
from malus._files import read_record, write_record
from malus.capture import linearize
from malus.errors import DataError, InputError
from malus.workspace import Workspace

Floats = NDArray[np.float64]
ROWS, COLUMNS = 4, 6
#: A patch brighter than this share of white is overexposed.
_CLIPPED = 0.98
#: A mean color difference above this points to a wrong place of the chart, a wrong order of patches or a wrong encoding.
_MOST_DELTA_E = 12.0


def srgb_bytes(linear: Floats) -> NDArray[np.uint8]:
    """8-bit sRGB of linear sRGB, any shape; black where the color is NaN."""
    value = np.clip(np.nan_to_num(linear), 0, 1)
    curved = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * curved), dtype=np.uint8)


@dataclass(frozen=True)
class ColorCorrection:
    """linear sRGB (D65) = matrix (3×3) · linear RGB of the camera, 1 = the chart's white under that light.

    delta_e: CIEDE2000 of the 24 patches. delta_e_left_out: the same for each patch with a matrix fitted to the other patches, which is
    the difference to expect for other colors. corners: of the chart in its image, pixels. source: the image or workspace measured.
    """

    matrix: Floats
    delta_e: Floats
    delta_e_left_out: Floats
    corners: Floats
    source: str

    def apply(self, color: NDArray[np.floating]) -> Floats:
        """Linear sRGB of the camera's linear color, H×W×3."""
        return np.asarray(color.astype(float) @ self.matrix.T, dtype=np.float64)

    def encoded(self, color: NDArray[np.floating]) -> NDArray[np.uint8]:
        """8-bit sRGB of the camera's linear color, H×W×3; black where the color is NaN."""
        return srgb_bytes(self.apply(color))

    def summary(self) -> str:
        """The color differences as a sentence."""
        return (
            f"color chart: CIEDE2000 {self.delta_e.mean():.2g} in the mean, {self.delta_e.max():.2g} at most; "
            f"{self.delta_e_left_out.mean():.2g} and {self.delta_e_left_out.max():.2g} on patches left out of the fit"
        )

    def save(self, path: str | Path) -> Path:
        """Write the correction as JSON."""
        write_record(
            Path(path),
            {
                "chart": "ColorChecker Classic, after November 2014",
                "source": self.source,
                "linear_srgb_from_camera": self.matrix.tolist(),
                "delta_e_2000": self.delta_e.tolist(),
                "delta_e_2000_left_out": self.delta_e_left_out.tolist(),
                "corners_px": self.corners.tolist(),
            },
        )
        return Path(path)

    @classmethod
    def load(cls, path: str | Path) -> ColorCorrection:
        """Read what `save` wrote; InputError for any other file."""
        if not Path(path).is_file():
            raise InputError(f"{path}: no such file, expected one that `malus chart` wrote")
        record = read_record(Path(path))
        if record is None or "linear_srgb_from_camera" not in record:
            raise InputError(f"{path}: is no color correction, expected a file that `malus chart` wrote, unchanged")
        names = ("linear_srgb_from_camera", "delta_e_2000", "delta_e_2000_left_out", "corners_px")
        matrix, within, left_out, corners = (np.array(record[name], dtype=np.float64) for name in names)
        return cls(matrix, within, left_out, corners, str(record["source"]))


def measure_chart(
    source: str | Path,
    *,
    corners: Sequence[float] | None = None,
    response: str = "linear",
    white_level: float | None = None,
    black_level: float = 0.0,
) -> ColorCorrection:
    """Measure a ColorChecker in a color image (PNG, TIFF, JPEG or RAW), or in a workspace whose view shows it.

    The light and the camera's settings must be those of the station. corners: x, y of the centers of the four corner patches: dark
    skin, bluish green, black, white (clockwise from the start of the first row); without them the chart is detected. response: of
    the image, "linear", "srgb", "gamma:X". white_level, black_level: digital numbers as in the station file, without which the
    colors of exports would be too bright or too dark; None = the full scale of the file. A RAW file states its own, and a
    workspace is linear.

    Raises InputError for a gray image, or for a response or levels with a RAW file or a workspace, DataError if no chart is found or its colors cannot be right, ExternalError without the extra
    `color`.
    """
    image = _linear_image(Path(source), response, white_level, black_level)
    centers = _found_centers(image, Path(source)) if corners is None else _between(corners)
    colors = _patches(image, centers)
    if float(colors.max()) > _CLIPPED:
        raise DataError(f"{source}: the chart's brightest patch is overexposed, expected a shorter exposure")
    return fit_colors(colors, str(source), centers[[0, COLUMNS - 1, -1, -COLUMNS]])


def fit_colors(colors: Floats, source: str, corners: Floats) -> ColorCorrection:
    """The correction for measured colors (24×3, linear) of the chart's patches, in the chart's order; DataError if they cannot be right."""
    with np.printoptions():  # importing colour changes NumPy's print options for the whole program
        colour = extra("colour", "colour-science", "malus chart", "color")
    reference = _reference(colour)
    matrix = _fitted(colors, reference)
    others = [np.delete(np.arange(len(colors)), k) for k in range(len(colors))]
    left_out = np.array([_fitted(colors[rest], reference[rest]) @ colors[k] for k, rest in enumerate(others)])
    within, without = (_differences(colour, found, reference) for found in (colors @ matrix.T, left_out))
    if within.mean() > _MOST_DELTA_E:
        raise DataError(
            f"{source}: the chart's colors are off by {within.mean():.0f} (CIEDE2000) after the best correction, expected "
            "below 12; is it a ColorChecker Classic the right way up, and the image as --response says?"
        )
    return ColorCorrection(matrix, within, without, corners, source)


def _linear_image(path: Path, response: str, white_level: float | None, black_level: float) -> NDArray[np.float32]:
    is_linear = path.is_dir() or raw.is_raw(path)
    if is_linear and (response, white_level, black_level) != ("linear", None, 0.0):
        raise InputError(
            f"{path}: response, white and black level are not for {'workspaces' if path.is_dir() else 'RAW files'}, which have them already"
        )
    if path.is_dir():
        image = Workspace(path).color()
    elif is_linear:
        image = raw.linear_image(path)
    else:
        levels, full_scale = _core.read_image_dn(str(path))
        white = full_scale if white_level is None else white_level
        image = linearize(levels, response=response, black_level=black_level, white_level=white)
    if image.ndim != 3:
        raise InputError(f"{path}: was taken in gray, expected a color image of the chart")
    return image


def _found_centers(image: NDArray[np.float32], path: Path) -> Floats:
    """Centers of the 24 patches (pixels), row by row from dark skin."""
    cv2 = extra("cv2", "opencv-contrib-python-headless", "malus chart without --corners", "color")
    shown = np.clip(np.nan_to_num(image) / np.nanpercentile(image, 99.5), 0, 1) ** (1 / 2.2)
    detector = cv2.mcc.CCheckerDetector_create()
    detector.setColorChartType(cv2.mcc.MCC24)
    if not detector.process(np.ascontiguousarray(np.rint(255 * shown[..., ::-1]).astype(np.uint8)), 1):
        raise DataError(
            f"{path}: no ColorChecker was found, expected one of 24 patches that fills a tenth of the image or more; "
            "or give its corners: --corners x,y,x,y,x,y,x,y"
        )
    box = np.asarray(detector.getBestColorChecker().getBox(), dtype=np.float64)
    # The detector's box ends at the outer edges of the patches.
    across, down = 0.5 / COLUMNS, 0.5 / ROWS
    corners = [(across, down), (1 - across, down), (1 - across, 1 - down), (across, 1 - down)]
    unit = _homography(np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float), box)
    return _between(_mapped(unit, np.array(corners)).ravel().tolist())


def _between(corners: Sequence[float]) -> Floats:
    if len(corners) != 8:
        raise InputError(f"--corners has {len(corners)} numbers, expected 8: x, y of the four corner patches' centers")
    target = np.array(corners, dtype=np.float64).reshape(4, 2)
    grid = np.array([(column, row) for row in range(ROWS) for column in range(COLUMNS)], dtype=np.float64)
    ends = grid[[0, COLUMNS - 1, -1, -COLUMNS]]
    return _mapped(_homography(ends, target), grid)


def _homography(source: Floats, target: Floats) -> Floats:
    """The projective map (3×3) from four points to four other points."""
    rows = []
    for (x, y), (u, v) in zip(source, target, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
    try:
        solution = np.linalg.solve(np.array(rows), target.ravel())
    except np.linalg.LinAlgError:
        raise InputError("--corners: three of them lie on one line, expected the corners of the chart") from None
    return np.append(solution, 1).reshape(3, 3)


def _mapped(homography: Floats, points: Floats) -> Floats:
    mapped = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def _patches(image: NDArray[np.float32], centers: Floats) -> Floats:
    """Median colors (24×3) of squares a third of the patches' distance wide."""
    grid = centers.reshape(ROWS, COLUMNS, 2)
    distance = min(float(np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min()) for axis in (0, 1))
    half = max(1, int(distance / 6))
    colors = np.empty((len(centers), 3))
    for k, (u, v) in enumerate(np.rint(centers).astype(int)):
        # A negative end would count from the other border.
        rows, columns = (slice(max(at - half, 0), max(at + half + 1, 0)) for at in (v, u))
        square = image[rows, columns].reshape(-1, 3)
        if not len(square) or not np.isfinite(square).all(-1).any():
            raise InputError(
                f"--corners: patch {k + 1} at {u}, {v} lies beside the image of {image.shape[1]} x {image.shape[0]}"
            )
        colors[k] = np.nanmedian(square, axis=0)
    return colors


def _reference(colour: Any) -> Floats:
    """Linear sRGB (D65) of the chart's patches, 24×3."""
    chart = colour.CCS_COLOURCHECKERS["ColorChecker24 - After November 2014"]
    xyz = colour.xyY_to_XYZ(np.array(list(chart.data.values())))
    return np.asarray(colour.XYZ_to_RGB(xyz, "sRGB", illuminant=chart.illuminant, apply_cctf_encoding=False))


def _fitted(colors: Floats, reference: Floats) -> Floats:
    """The 3×3 matrix of least squares of relative differences, because a difference on a dark patch is as visible as on a bright one."""
    weight = 1 / (reference.mean(-1, keepdims=True) + 0.05)
    return np.asarray(np.linalg.lstsq(colors * weight, reference * weight, rcond=None)[0].T)


def _differences(colour: Any, found: Floats, reference: Floats) -> Floats:
    """CIEDE2000 between measured and reference colors, both linear sRGB."""
    one, other = (colour.XYZ_to_Lab(colour.RGB_to_XYZ(rgb, "sRGB")) for rgb in (found, reference))
    return np.asarray(colour.delta_E(one, other, method="CIE 2000"), dtype=np.float64)
