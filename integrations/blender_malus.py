"""Blender add-on: File > Import > Malus workspace.

Imports the textured surface and the station's camera; confidence, GSD and catalog data become custom properties of the surface.
Lengths stay true: the scene's unit becomes millimeters, one Blender unit is a meter. Needs only Blender 3.4 or later.
"""

import json
import math
from pathlib import Path

import bpy
import numpy
from bpy.props import BoolProperty, StringProperty
from bpy_extras.io_utils import ImportHelper
from mathutils import Matrix

bl_info = {
    "name": "Malus workspace",
    "author": "Malus",
    "version": (1, 0, 0),
    "blender": (3, 4, 0),
    "location": "File > Import > Malus workspace",
    "description": "Import the surface, camera and record of a workspace of Malus",
    "category": "Import-Export",
}


def import_workspace(folder, *, use_units=True):
    """Import a finished workspace; returns the mesh object and the camera object. ValueError names a missing file."""
    folder = Path(folder)
    for name in ("manifest.json", "quality.json", "fused/surface.glb"):
        if not (folder / name).is_file():
            raise ValueError(f"{folder / name}: is not there, expected a folder that `malus run` has finished")
    quality = json.loads((folder / "quality.json").read_text(encoding="utf-8"))
    if not hasattr(numpy, "bool"):
        # The importer of Blender 3.4 in Debian 12 is older than its numpy and needs the removed name numpy.bool.
        numpy.bool = bool
    before = set(bpy.data.objects)
    bpy.ops.import_scene.gltf(filepath=str(folder / "fused" / "surface.glb"))
    new = [thing for thing in bpy.data.objects if thing not in before]
    for thing in new:
        if thing.parent is None:
            # The file's z axis is up, as in Blender's world; the importer assumed glTF's y up and rotated the object.
            thing.matrix_world = Matrix.Rotation(-math.pi / 2, 4, "X") @ thing.matrix_world
    bpy.context.view_layer.update()
    mesh = next(thing for thing in new if thing.type == "MESH")
    camera = next(thing for thing in new if thing.type == "CAMERA")
    mesh.name, camera.name = quality["name"], f"{quality['name']} station"
    _tell(mesh, quality)
    _frame(camera, folder, quality)
    if use_units:
        units = bpy.context.scene.unit_settings
        units.system, units.length_unit = "METRIC", "MILLIMETERS"
    bpy.context.scene.camera = camera
    return mesh, camera


def _tell(mesh, quality):
    """Write the data about the surface to where Blender shows them: Object Properties > Custom Properties."""
    mesh["confidence"] = quality["confidence"]["level"]
    mesh["confidence_reasons"] = "; ".join(quality["confidence"]["reasons"])
    mesh["gsd"] = quality["gsd"]
    mesh["unit_of_the_station"] = quality["unit"]
    for key, value in (quality.get("object") or {}).items():
        if value:
            mesh[f"object_{key}"] = value


def _frame(camera, folder, quality):
    """Set the camera to render the station's image: its size, its principal point, and clip distances that keep near objects."""
    words = next(
        line for line in (folder / "fused/camera.txt").read_text().splitlines() if line and not line.startswith("#")
    ).split()
    width, height = int(words[2]), int(words[3])
    fx, fy, cx, cy = (float(word) for word in words[4:8])
    render = bpy.context.scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    render.pixel_aspect_x, render.pixel_aspect_y = 1, fx / fy
    lens = camera.data
    lens.sensor_fit = "HORIZONTAL"
    lens.lens = fx / width * lens.sensor_width
    # Blender's shift is a share of the longer side; COLMAP's coordinates start at the image's corner.
    lens.shift_x, lens.shift_y = (0.5 * width - cx) / width, (cy - 0.5 * height) / width
    lens.clip_start, lens.clip_end = 1e-3, 1e3


class ImportMalusWorkspace(bpy.types.Operator, ImportHelper):
    """Import the manifest.json of a finished workspace."""

    bl_idname = "import_scene.malus"
    bl_label = "Import Malus workspace"
    bl_options = {"REGISTER", "UNDO"}

    filename_ext = ".json"
    filter_glob: StringProperty(default="manifest.json", options={"HIDDEN"})
    use_units: BoolProperty(name="Show millimeters", default=True)

    def execute(self, context):
        """Import, or report what is missing."""
        try:
            import_workspace(Path(self.filepath).parent, use_units=self.use_units)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


def _menu(self, context):
    self.layout.operator(ImportMalusWorkspace.bl_idname, text="Malus workspace (manifest.json)")


def register():
    """Called by Blender."""
    bpy.utils.register_class(ImportMalusWorkspace)
    bpy.types.TOPBAR_MT_file_import.append(_menu)


def unregister():
    """Called by Blender."""
    bpy.types.TOPBAR_MT_file_import.remove(_menu)
    bpy.utils.unregister_class(ImportMalusWorkspace)
