"""The object's own color on its mesh: the albedos of the stations, blended in the same way as their photographs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from malus.albedo import albedo_of
from malus.errors import DataError
from malus.object.arrays import on_disk
from malus.object.color import Paint
from malus.object.meshing import ObjectMesh
from malus.object.views import Singles, View
from malus.workspace import Workspace


@dataclass(frozen=True)
class Albedos:
    """Linear images (H×W×C) of the stations whose albedo is known, each up to a factor. unknown: for all other stations the reason, by name."""

    views: Sequence[View]
    images: Sequence[Singles]
    unknown: Mapping[str, str]

    @staticmethod
    def of(views: Sequence[View], stations: Path, scratch: Path) -> Albedos:
        """The albedos of finished stations. stations: folder with their workspaces, by name. scratch: folder for the images."""
        known: list[View] = []
        images: list[Singles] = []
        unknown: dict[str, str] = {}
        for view in views:
            try:
                albedo = albedo_of(Workspace(stations / view.name)).reshape(view.color.shape)
            except DataError as error:
                # The page need not show the workspace's path.
                unknown[view.name] = str(error).replace(str(stations / view.name), view.name)
                continue
            known.append(view)
            images.append(on_disk(albedo, scratch / view.name))
        return Albedos(known, images, unknown)

    def paint(self, mesh: ObjectMesh) -> Paint | None:
        """How the albedos are blended on a mesh; None if there are none."""
        return Paint.of(self.views, mesh.vertices, mesh.normals, self.images) if self.views else None

    def figures(self) -> dict[str, Any]:
        """For quality.json: the stations whose albedo is in the texture, and why the albedo of others is not."""
        return {"stations": [view.name for view in self.views], "unknown": dict(self.unknown)}
