"""A ball with bumps, like a toy hedgehog."""

from .round_objects import STYLES, scene_of

scene = scene_of("hedgehog")

__all__ = ["STYLES", "scene"]
