"""Whole objects: many stations become one surface.

    import malus.object
    thing = malus.Object.load("object.toml")
    malus.object.run_object(thing, "OUT", jobs=2)          # OUT/object/mesh.ply, mesh.glb, quality.json, report/index.html

`combine` joins the stations' surfaces into oriented points, `pieces` and `joined_mesh` make a mesh of these points, `closed_surface`
closes the mesh, `levels_of_detail` gives it textures.
"""

from malus.object.agreement import Agreement, OrientedPoints, agreement_figures, combine, unseen_stereo
from malus.object.color import Paint
from malus.object.definition import Object
from malus.object.implicit import pieces
from malus.object.joining import Piece, joined_mesh
from malus.object.meshing import ObjectMesh, closed_surface, poisson_mesh
from malus.object.run import run_object
from malus.object.texture import TexturedMesh, levels_of_detail, textured
from malus.object.views import View, load_view

__all__ = [
    "Agreement",
    "Object",
    "ObjectMesh",
    "OrientedPoints",
    "Paint",
    "Piece",
    "TexturedMesh",
    "View",
    "agreement_figures",
    "closed_surface",
    "combine",
    "joined_mesh",
    "levels_of_detail",
    "load_view",
    "pieces",
    "poisson_mesh",
    "run_object",
    "textured",
    "unseen_stereo",
]
