"""A shell: ridges and spots."""

from .round_objects import STYLES, scene_of

scene = scene_of("shell")

__all__ = ["STYLES", "scene"]
