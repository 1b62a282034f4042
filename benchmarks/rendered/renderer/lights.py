"""Light sources as Mitsuba dictionaries, and rooms as environment maps."""

import numpy as np
from tracer import mi


def direction(azimuth, elevation):
    """Unit vector towards a light: azimuth from +x to +y, elevation above the x-y plane, in degrees."""
    a, e = np.radians([azimuth, elevation])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def directional(to_light, irradiance):
    return dict(type="directional", direction=[float(-v) for v in to_light], irradiance=float(irradiance))


def constant(radiance):
    return dict(type="constant", radiance=float(radiance), sampling_weight=0.0)


def _facing(center, target, size, up):
    t = mi.ScalarTransform4f
    return t().look_at(origin=list(map(float, center)), target=list(map(float, target)), up=up) @ t().scale(
        [size[0] / 2, size[1] / 2, 1]
    )


def softbox(center, size, radiance, target=(0, 0, 0), up=(0, 1, 0)):
    """Rectangular area light (width, height) facing the target."""
    return dict(
        type="rectangle",
        to_world=_facing(center, target, size, list(up)),
        bsdf=dict(type="diffuse", reflectance=0.0),
        emitter=dict(type="area", radiance=float(radiance)),
    )


def card(center, size, albedo, target=(0, 0, 0), up=(0, 0, 1)):
    """White reflector card, which emits no light."""
    return dict(
        type="rectangle",
        to_world=_facing(center, target, size, list(up)),
        bsdf=dict(type="twosided", b=dict(type="diffuse", reflectance=float(albedo))),
    )


def room(radiance, height=256):
    """Environment map; radiance(d) is the radiance from the unit directions d (..., 3) in the world frame."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(2 * height) + 0.5) / (2 * height), indexing="ij")
    theta, phi = np.pi * v, 2 * np.pi * u
    d = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], -1)
    L = np.asarray(radiance(d), np.float32)
    return dict(type="envmap", bitmap=mi.Bitmap(np.repeat(L[..., None], 3, -1)))


def rectangle_in_room(d, azimuth, elevation, width, height, soft=1.0):
    """Soft indicator (0..1) of a window-like rectangle (degrees) for the directions d, with +z up."""
    az = np.degrees(np.arctan2(d[..., 1], d[..., 0]))
    el = np.degrees(np.arcsin(np.clip(d[..., 2], -1, 1)))
    da = np.abs((az - azimuth + 180) % 360 - 180)
    inside = lambda x, half: 1 / (1 + np.exp(np.clip((x - half) / soft, -50, 50)))
    return inside(da, width / 2) * inside(np.abs(el - elevation), height / 2)
