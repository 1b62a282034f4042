"""Cameras of an Agisoft Metashape project, exported as cameras.xml."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from malus._files import read_regular
from malus.camera import Camera
from malus.errors import InputError


def _numbers(text: str | None, count: int, where: str) -> list[float]:
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        raise InputError(f"{where} = {text!r}, expected {count} numbers")
    return values


@dataclass(frozen=True)
class _Similarity:
    """x' = scale · rotation · x + translation."""

    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]
    scale: float


def _similarity(parent: ElementTree.Element, where: str) -> _Similarity | None:
    """The <transform> of a chunk or a component; None where it has none."""
    transform = parent.find("transform")
    if transform is None:
        return None

    def values(tag: str, count: int, default: list[float]) -> NDArray[np.float64]:
        element = transform.find(tag)
        return np.array(default if element is None else _numbers(element.text, count, f"{where}: <{tag}>"))

    rotation = values("rotation", 9, [1, 0, 0, 0, 1, 0, 0, 0, 1]).reshape(3, 3)
    return _Similarity(rotation, values("translation", 3, [0, 0, 0]), float(values("scale", 1, [1])[0]))


def _lens(sensor: ElementTree.Element, where: str) -> tuple[str, int, int, list[float]]:
    """Metashape's frame camera, which like OpenCV goes from ideal to measured coordinates:
    x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2x²) + 2 p2 x y, u = w/2 + cx + f x' + b1 x' + b2 y'. Its pixel
    centers are at +0.5.
    """
    if sensor.get("type", "frame") != "frame":
        raise InputError(f'{where}: camera type {sensor.get("type")!r}, expected "frame"')
    size = sensor.find("resolution")
    calibrations = sensor.findall("calibration")
    adjusted = [c for c in calibrations if c.get("class") == "adjusted"]
    if size is None or not calibrations:
        raise InputError(f"{where} has no <resolution> or no <calibration>, expected both")
    calibration = (adjusted or calibrations)[-1]
    values = {
        child.tag: _numbers(child.text, 1, f"{where}: <{child.tag}>")[0]
        for child in calibration
        if child.tag != "resolution"
    }
    for name in ("b2", "k4", "p3", "p4"):
        if values.get(name):
            raise InputError(
                f"{where}: <{name}> = {values[name]} is not supported, expected 0; fit the cameras without it"
            )
    if "f" not in values:
        raise InputError(f"{where}: <calibration> has no <f>")
    width, height = (int(_numbers(size.get(key), 1, f"{where}: {key}")[0]) for key in ("width", "height"))
    focal_y = values["f"]
    focal_x = focal_y + values.get("b1", 0.0)
    center = [width / 2 + values.get("cx", 0.0) - 0.5, height / 2 + values.get("cy", 0.0) - 0.5]
    # The tangential terms are named the other way round in OpenCV.
    terms = [values.get(name, 0.0) for name in ("k1", "k2", "p2", "p1", "k3")]
    return "FULL_OPENCV", width, height, [focal_x, focal_y, *center, *terms, 0.0, 0.0, 0.0]


def _chunks(file: Path) -> Sequence[ElementTree.Element]:
    try:
        return ElementTree.fromstring(read_regular(file)).findall("chunk")
    # LookupError and ValueError: the file names an encoding that does not exist or that the parser does not support.
    except (OSError, ElementTree.ParseError, LookupError, ValueError) as error:
        raise InputError(f"{file}: not a cameras.xml ({error})") from None


def _aligned(chunk: ElementTree.Element) -> list[tuple[str, ElementTree.Element]]:
    """The cameras of a chunk that have a position, with names that tell cameras of one label apart."""
    placed = [element for element in chunk.iter("camera") if element.find("transform") is not None]
    shared = Counter(element.get("label") for element in placed)

    def name_of(element: ElementTree.Element) -> str:
        label = element.get("label") or str(element.get("id"))
        return f"{label} (camera {element.get('id')})" if shared[element.get("label")] > 1 else label

    return [(name_of(element), element) for element in placed]


@dataclass(frozen=True)
class MetashapeChunk:
    """What a cameras.xml says of a chunk, besides its cameras' lenses and poses."""

    label: str
    cameras: list[str]
    """Names of the cameras that have a position."""
    coordinates: str
    """Coordinate system in WKT; empty if the file does not say it."""

    @property
    def in_meters(self) -> bool:
        """Whether the coordinate system says that the cameras' positions are in meters."""
        return self.on_earth or 'UNIT["metre",1' in self.coordinates

    @property
    def on_earth(self) -> bool:
        """Whether the cameras' positions are geocentric, as Metashape writes them for all but local coordinates."""
        return bool(self.coordinates) and not self.coordinates.startswith("LOCAL_CS")


def metashape_chunks(path: str | Path) -> list[MetashapeChunk]:
    """The chunks of a Metashape cameras.xml. Raises InputError if it is none."""
    return [
        MetashapeChunk(
            chunk.get("label") or str(number),
            [name for name, _ in _aligned(chunk)],
            (chunk.findtext("reference") or "").strip(),
        )
        for number, chunk in enumerate(_chunks(Path(path)))
    ]


def read_metashape(path: str | Path, chunk: int = 0, only: str | None = None) -> dict[str, Camera]:
    """Cameras with lens and pose, by label, of one chunk of a Metashape cameras.xml; `only`: the one of this name.

    World frame and unit follow from the transform of a camera's component (in versions that divide chunks into components), else from
    the transform of the chunk; without a transform they are the chunk's own. Cameras without a position are left out. Poses are
    returned as cam_from_world, lenses as FULL_OPENCV. Labels that several cameras share, such as DSC_0001 of two memory cards, get
    the cameras' numbers: "DSC_0001 (camera 7)". Raises InputError naming file and element; lenses of other cameras than those that
    are returned may be of any kind.
    """
    file = Path(path)
    chunks = _chunks(file)
    if not 0 <= chunk < len(chunks):
        raise InputError(f"{file}: chunk {chunk} of {len(chunks)}, expected one that is there")
    source = chunks[chunk]
    of_chunk = _similarity(source, str(file)) or _Similarity(np.eye(3), np.zeros(3), 1.0)
    of_component = {
        component.get("id"): _similarity(component, f"{file}: component {component.get('id')}")
        for component in source.iterfind("components/component")
    }
    aligned = [(name, element) for name, element in _aligned(source) if only in (None, name)]
    used = {element.get("sensor_id") for _, element in aligned}
    lenses = {
        sensor.get("id"): _lens(sensor, f'{file}: sensor "{sensor.get("label", sensor.get("id"))}"')
        for sensor in source.iterfind("sensors/sensor")
        if sensor.get("id") in used and sensor.find("calibration") is not None
    }
    cameras: dict[str, Camera] = {}
    for name, element in aligned:
        where = f'{file}: camera "{name}"'
        if element.get("sensor_id") not in lenses:
            raise InputError(f"{where} has sensor {element.get('sensor_id')!r}, which has no calibration")
        chunk_from_cam = np.array(_numbers(element.findtext("transform"), 16, f"{where}: <transform>")).reshape(4, 4)
        world = of_component.get(element.get("component_id")) or of_chunk
        world_from_cam = world.rotation @ chunk_from_cam[:3, :3]
        center = world.scale * world.rotation @ chunk_from_cam[:3, 3] + world.translation
        model, width, height, params = lenses[element.get("sensor_id")]
        cameras[name] = Camera(model, width, height, params, world_from_cam.T, -world_from_cam.T @ center)
    return cameras
