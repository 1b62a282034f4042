"""One file for each scene, which has

    scene(style, rng, quality) -> dict     the description of the scene, see below
    STYLES = {name: dict}                  parameters of variants of the scene: seed, shape, texture, light, pose

World frame: right-handed, millimeters, +z towards the station camera, +y up in its image (upright objects: +y is up).
The description has
  meshes     list of dict(name, V, N, F, uv | None, tex | None, albedo | None, bsdf, label, material); names of the object's meshes
             start with "object", and their label is 1; tex = diffuse albedo over uv
  lights     Mitsuba emitters and reflectors; light_meta = their description for meta.json
  stations   list of dict(target, dist, focal_mm, roll, tilt | direction), see cameras.station_camera
  views      the photographs, see cameras.convergent_photos and ring_photos
  flat       exactly flat areas: dict(name, c, half) in world x, y
  points     {name: xyz}, ends of known distances
  mvs        dict(keep, noise): share of the object's points that stereo finds, and their noise in GSD
  material   for meta.json; materials = {number: name} if an object has several
  optional   size, view_size, spp, depth (path length), view_depth, hide_lights, distortion, jpeg, truth_mesh, photos_self_calibrate
"""

import importlib
import pkgutil

_MODULES = {m.name: importlib.import_module(f"{__name__}.{m.name}") for m in pkgutil.iter_modules(__path__)}
SCENES = {name: module for name, module in _MODULES.items() if hasattr(module, "scene")}
