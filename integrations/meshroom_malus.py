"""Meshroom node (2025 and later) that runs a station. Meshroom loads packages only: put this file and an empty file __init__.py into a
folder malus_nodes, and name the parent of malus_nodes in MESHROOM_NODES_PATH.

`malus` must be on the PATH. Outputs: the workspace, its mesh for the nodes that follow, and its report.
"""

__version__ = "1.0"

from meshroom.core import desc


class MalusReconstruction(desc.CommandLineNode):
    """Surface of a station from polarization and stereo."""

    commandLine = 'malus run "{stationValue}" -o "{workspaceValue}" --fusion {fusionValue} --quiet'
    category = "Photogrammetry"
    documentation = (
        "Fuses the polarized images of a station with its coarse surface into a metric mesh with stated accuracy."
    )

    inputs = [
        desc.File(
            name="station",
            label="Station File",
            description="station.toml: images, polarizer angles, camera and coarse surface (or photographs).",
            value="",
        ),
        desc.ChoiceParam(
            name="fusion",
            label="Fusion",
            description="Nonlinear refinement, or the transfer of the paper.",
            value="refined",
            values=["refined", "grid"],
            exclusive=True,
        ),
    ]
    outputs = [
        # A subfolder: Meshroom keeps its log and status in the node's folder, and Malus refuses a folder with other files.
        desc.File(
            name="workspace",
            label="Workspace",
            description="Folder with every result.",
            value="{nodeCacheFolder}/workspace",
        ),
        desc.File(
            name="mesh",
            label="Mesh",
            description="Textured surface, world frame, meters.",
            value="{nodeCacheFolder}/workspace/fused/surface.glb",
            semantic="3d",
        ),
        desc.File(
            name="report",
            label="Report",
            description="How far the surface may be trusted, and every figure.",
            value="{nodeCacheFolder}/workspace/report/index.html",
        ),
    ]
