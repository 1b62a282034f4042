"""A ball of one albedo."""

from .round_objects import STYLES, scene_of

scene = scene_of("ball")

__all__ = ["STYLES", "scene"]
