"""Whole objects: many stations become one surface.

    import malus.object
    thing = malus.Object.load("object.toml")
    malus.object.run_object(thing, "OUT", jobs=2)          # OUT/object/mesh.ply, mesh.glb, quality.json, report/index.html

`combine` joins stations' surfaces to oriented points, `poisson_mesh` makes a mesh of those, `textured` its texture.
"""

from malus.object.agreement import Agreement, OrientedPoints, agreement_figures, combine, unseen_stereo
from malus.object.definition import Object
from malus.object.meshing import ObjectMesh, poisson_mesh, trimmed
from malus.object.run import run_object
from malus.object.texture import TexturedMesh, textured
from malus.object.views import View, load_view

__all__ = [
    "Agreement",
    "Object",
    "ObjectMesh",
    "OrientedPoints",
    "TexturedMesh",
    "View",
    "agreement_figures",
    "combine",
    "load_view",
    "poisson_mesh",
    "run_object",
    "textured",
    "trimmed",
    "unseen_stereo",
]
