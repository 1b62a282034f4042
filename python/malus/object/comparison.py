"""An object's reference beside its mesh: registered if wished, compared, and written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from malus._files import with_relative_paths
from malus.errors import DataError
from malus.object import page, reference
from malus.object.definition import Object
from malus.object.meshing import ObjectMesh
from malus.object.ply import columns, write_ply
from malus.object.reference import Comparison
from malus.object.views import View


def compared_with_reference(
    thing: Object, mesh: ObjectMesh, views: Sequence[View], gsd: float, threads: int
) -> tuple[Comparison | None, dict[str, Any] | None]:
    """Comparison of the mesh with the object's reference (None without a reference or if it does not fit), and its entry in quality.json."""
    scan = thing.read_reference()
    if scan is None:
        return None, None
    said: dict[str, Any] = {
        "file": with_relative_paths(str(thing.reference), thing.folder),
        "registered": thing.register,
    }
    try:
        if thing.register:
            placed = reference.place(scan, views)
            scan, at_rest = reference.aligned(scan.moved(placed.rotation, placed.translation), mesh, gsd, threads)
            said |= {
                "correlation": placed.correlation, "next_best": placed.next_best, "alignment_converged": at_rest
            }  # fmt: skip
        comparison = reference.compare(scan, mesh, gsd, threads)
    except DataError as error:
        # A failed comparison must not discard the surface, which is valid and took hours.
        return None, {**said, "status": str(error)}
    return comparison, {**said, "status": "done", **comparison.figures}


def write_comparison(
    folder: Path, comparison: Comparison | None, mesh: ObjectMesh, views: Sequence[View], gsd: float, thing: Object
) -> list[Path]:
    """Write maps of the distances in the stations' images, and the moved reference if it was registered."""
    if comparison is None:
        return []
    files = page.write_distances(folder / "reference", comparison.distances, mesh, views, gsd)
    if thing.register:
        path, scan = folder / "reference" / "registered.ply", comparison.reference
        write_ply(path, columns("xyz", scan.points, "f8"), scan.triangles, "reference moved onto the surface")
        files.append(path)
    return files
