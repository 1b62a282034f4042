"""Point clouds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from malus._extra import extra
from malus._files import replacing
from malus.e57_export import write_e57
from malus.exports.exporter import Exporter
from malus.object import arrays
from malus.units import METERS


def export_las(exporter: Exporter, path: Path) -> None:
    """Points with color, normal and standard deviation, LAS 1.4 or LAZ."""
    library = extra("laspy", "laspy", f"{path}: LAS")
    if path.suffix.lower() == ".laz":
        extra("lazrs", "lazrs", f"{path}: LAZ")
    cloud, sigma = exporter.cloud()
    header = library.LasHeader(point_format=7, version="1.4")
    # The specification requires this bit with point formats 6 to 10; converters to COPC refuse files without it.
    header.global_encoding.wkt = True
    header.offsets = cloud.vertices.mean(0)
    # LAS stores whole numbers: steps of a thousandth of a pixel or finer.
    header.scales = np.full(3, 10.0 ** np.floor(np.log10(1e-3 * exporter.workspace.quality["gsd"])))
    for name in ("sigma", "normal_x", "normal_y", "normal_z"):
        header.add_extra_dim(library.ExtraBytesParams(name=name, type=np.float32))
    # The text record of the LAS specification, 65 535 bytes at most; a zero ends it.
    text = "\n".join(exporter.words()).encode()[:65534] + b"\0"
    header.vlrs.append(library.VLR("LASF_Spec", 3, "[object]", text))
    points = library.LasData(header)
    points.x, points.y, points.z = cloud.vertices.T
    # Each point is the first of one return: with 0 the header's numbers of points by return would be 0, too.
    points.return_number = np.ones(len(cloud.vertices), np.uint8)
    points.number_of_returns = np.ones(len(cloud.vertices), np.uint8)
    points.red, points.green, points.blue = cloud.colors.T.astype(np.uint16) * 257
    points.sigma = sigma.astype(np.float32)
    points.normal_x, points.normal_y, points.normal_z = cloud.normals.T
    with replacing(path) as temporary:
        points.write(str(temporary))


def export_xyz(exporter: Exporter, path: Path) -> None:
    """Points as text, one a line."""
    cloud, sigma = exporter.cloud()
    length = f"%.{exporter.decimals}f"
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.writelines(f"# {line}\n" for line in exporter.words())
        file.write("# x y z red green blue nx ny nz sigma\n")
        # In parts, because text of all rows of 100 megapixels would take many times the cloud's memory.
        for rows in arrays.chunks(len(cloud.vertices)):
            table = np.column_stack([cloud.vertices[rows], cloud.colors[rows], cloud.normals[rows], sigma[rows]])
            np.savetxt(file, table, " ".join([*[length] * 3, "%d %d %d", "%.5f %.5f %.5f", length]))


def export_e57(exporter: Exporter, path: Path) -> None:
    """Points with color and normal, in meters."""
    cloud, _ = exporter.cloud()
    points = cloud.vertices * METERS[exporter.unit]
    # Floats of 32 bits are written. Far from the origin, as in a national grid, points are stored about their middle, which the scan's
    # pose adds to them; near it as they are, for readers that take no pose.
    largest, pixel = np.abs(points).max(), exporter.workspace.quality["gsd"] * METERS[exporter.unit]
    middle = points.mean(0) if largest * 2.0**-24 > 1e-3 * pixel else np.zeros(3)
    said = {**exporter.said, "unit": "m"}
    name = f"{exporter.name} (confidence {said['confidence']})"
    write_e57(path, points - middle, cloud.normals, cloud.colors, middle, name, said)
