"""One file a scene. Each has

    scene(style, rng, quality) -> dict     the description below
    STYLES = {name: dict}                  what differs between variants of the scene: seed, shape, texture, light, pose

World frame: right-handed, millimeters, +z towards the station camera, +y up in its image (upright objects: +y is up).
The description has
  meshes     list of dict(name, V, N, F, uv | None, tex | None, albedo | None, bsdf, label, material); the object's names start
             with "object" and its label is 1; tex = diffuse albedo over uv
  lights     Mitsuba emitters and reflectors; light_meta = the same in words and numbers
  stations   list of dict(target, dist, focal_mm, roll, tilt | direction), see cameras.station_camera
  views      the photographs, see cameras.convergent_photos and ring_photos
  flat       truly flat areas: dict(name, c, half) in world x, y;  points = {name: xyz} ends of known distances
  mvs        dict(keep, noise): how well stereo does on the object
  material   for meta.json; materials = {number: name} where an object has several
  optional   size, view_size, spp, depth (path length), view_depth, hide_lights, distortion, jpeg, truth_mesh, photos_self_calibrate
"""

import importlib
import pkgutil

_MODULES = {m.name: importlib.import_module(f"{__name__}.{m.name}") for m in pkgutil.iter_modules(__path__)}
SCENES = {name: module for name, module in _MODULES.items() if hasattr(module, "scene")}
