"""The HTML report of a workspace: one self-contained page with every figure of quality.json."""

from __future__ import annotations

import base64
import platform
import webbrowser
from collections.abc import Iterator, Mapping
from importlib import metadata, resources
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup, escape

from malus import _core, viewer
from malus._files import write_bytes, write_text
from malus.errors import ExternalError, InputError
from malus.figures import Figure, Plates, encode, grey
from malus.options import Options
from malus.reconstruction import STEPS
from malus.workspace import Workspace

#: The surfaces that figures compare, in their order.
SURFACES = ("prior", "polarization", "fused")
#: What the checks of the inputs look at, by the names in evidence/findings.json.
CHECKS = {
    "order": "Order of the images",
    "encoding": "Encoding of the image files",
    "response": "Response of the camera",
    "contrast": "Contrast against the cloud's colors",
    "size": "Size and distance",
    "phase": "Polarization against the prior's slopes",
    "prior": "Place of the prior in the images",
}
#: Parts of quality.json that only some runs have, with their headings; shown number by number.
_OTHERS = (("photogrammetry", "Photographs"), ("sweep", "Stereo sweep"))


def _number(value: Any, digits: int = 3) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    return f"{value:.{digits}g}" if abs(value) < 1000 else f"{value:.0f}"


def caution_lines(quality: Mapping[str, Any]) -> list[str]:
    """Every warning, and the confidence with its reasons unless it is high."""
    confidence = quality["confidence"]
    lines = [f"warning: {warning}" for warning in quality["warnings"]]
    if confidence["level"] != "high":
        lines += [f"confidence: {confidence['level']}", *(f"  {reason}" for reason in confidence["reasons"])]
    return lines


def summary_lines(quality: Mapping[str, Any]) -> list[str]:
    """The figures that matter first, a line each, for the terminal."""
    unit = quality["unit"]
    lines = [
        f"{quality['name']}: {quality['method']} fusion, {quality['status']}",
        f"  GSD {_number(quality['gsd'], 4)} {unit}, coverage {100 * quality['coverage']['fraction']:.1f} %",
        f"  confidence: {quality['confidence']['level']}",
        *(f"    {reason}" for reason in quality["confidence"]["reasons"]),
    ]
    for patch in quality["patches"]:
        fits = {name: patch[name] for name in SURFACES if patch[name] is not None}
        shares = ", ".join(f"{name} {_number(fit['rmse_gsd'])}" for name, fit in fits.items())
        lines.append(f"  patch {patch['name']}: plane RMSE / GSD: {shares}")
    if quality["reference"]:
        distance = quality["reference"]["distance_gsd"]
        lines.append(f"  reference: RMSE / GSD {_number(distance['rmse'])}, robust {_number(distance['mad'])}")
    lines += [f"  warning: {warning}" for warning in quality["warnings"]]
    return lines


class _Quality:
    """Numbers of quality.json by their path ("patches.0.fused.rmse_gsd"), and of m3c2.json ("m3c2.…")."""

    def __init__(self, quality: Mapping[str, Any]) -> None:
        self._quality = quality

    def at(self, path: str) -> Any:
        value: Any = self._quality
        for key in path.split("."):
            value = value[int(key)] if isinstance(value, list) else value[key]
        return value

    def element(self, path: str, digits: int = 3, factor: float = 1) -> Markup:
        """The number as people read it, in an element that keeps the exact value and where it stands."""
        value = self.at(path)
        shown = value * factor if isinstance(value, int | float) and factor != 1 else value
        exact = "" if value is None else escape(value)
        return Markup(f'<data value="{exact}" data-path="{escape(path)}">{escape(_number(shown, digits))}</data>')

    def leaves(self, root: str) -> list[str]:
        """Paths below a part, of everything that is not a list or an object."""

        def walk(value: Any, path: str) -> Iterator[str]:
            if isinstance(value, Mapping | list):
                items = value.items() if isinstance(value, Mapping) else enumerate(value)
                for key, inner in items:
                    yield from walk(inner, f"{path}.{key}" if path else str(key))
            else:
                yield path

        return list(walk(self.at(root), ""))


def _figures(plates: Plates) -> dict[str, list[Figure]]:
    quality = plates.quality
    profiles = [plates.profile_lines(), *plates.profiles()] if quality["profiles"] else []
    return {
        "relief": [*plates.shadings(), *plates.elevations()],
        "polarization": list(plates.polarization()),
        "height": list(plates.height()),
        "profiles": profiles,
        "patches": list(plates.patches()),
        "uncertainty": list(plates.uncertainty()),
        "reference": list(plates.reference()),
        "m3c2": list(plates.m3c2()),
    }


def _changed_options(options: Mapping[str, Any]) -> list[tuple[str, Any]]:
    defaults = Options().to_dict()
    changed: list[tuple[str, Any]] = []
    for section, values in options.items():
        if isinstance(values, Mapping):
            known = defaults.get(section, {})
            changed += [(f"{section}.{key}", value) for key, value in values.items() if known.get(key) != value]
        elif values != defaults.get(section):
            changed.append((section, values))
    return changed


def _asset(name: str) -> Markup:
    """An own file for the page, as it is."""
    return Markup(resources.files("malus").joinpath("assets", name).read_text(encoding="utf-8"))


def _compare(plates: Plates) -> dict[str, bytes]:
    box = plates.object_box()
    return {name: encode(grey(plates.shade(name))[box], "WEBP", quality=90) for name in ("prior", "fused")}


def _trust(plates: Plates) -> bytes | None:
    """Where the surface is refined and where it is the prior's, over its relief shading."""
    if not plates.workspace.has("fused/trust.png"):
        return None
    return encode(plates.trust_picture()[plates.object_box()], "WEBP", quality=85)


def _sections(quality: Mapping[str, Any], figures: Mapping[str, list[Figure]]) -> list[tuple[str, str]]:
    every = [
        ("overview", "Overview"), ("checks", "Checks"), ("compare", "Before and after"), ("explore", "Relight and turn"), ("relief", "Relief"),
        ("polarization", "Polarization"), ("height", "Height"), ("profiles", "Profiles"), ("patches", "Patches"),
        ("uncertainty", "Uncertainty"), ("reference", "Reference"), ("m3c2", "M3C2"), ("scale", "Scale"), *_OTHERS, ("provenance", "Provenance"),
    ]  # fmt: skip
    optional = ("profiles", "patches", "reference", "scale", *(name for name, _ in _OTHERS))
    absent = {name for name in optional if not quality.get(name)}
    absent |= {"height", "m3c2"} - {name for name, group in figures.items() if group}
    return [(name, title) for name, title in every if name not in absent]


def write_report(work: str | Path) -> Path:
    """Write WORK/report/index.html, and its figures as PNG and CSV beside it, from the workspace; returns the page's path.

    Raises InputError unless all that it shows is as the steps left it, from images to figures.
    """
    workspace = Workspace(work)
    quality, manifest = workspace.quality, workspace.manifest
    plates = Plates(workspace)
    steps = [step for step in STEPS if step in manifest["steps"] and step != "report"]
    figures = _figures(plates)
    m3c2 = workspace.m3c2
    numbers = _Quality({**quality, "m3c2": m3c2})
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["number"] = _number
    environment.filters["base64"] = lambda content: base64.b64encode(content).decode()
    environment.globals.update(q=numbers.element, leaves=numbers.leaves, asset=_asset)
    template = environment.from_string(resources.files("malus").joinpath("templates/report.html.j2").read_text("utf-8"))
    registration = [-1.0 if rms is None else rms for rms in quality["registration_rms_px"]]
    page = template.render(
        quality=quality,
        m3c2=m3c2,
        findings=workspace.findings,
        checks=CHECKS,
        scale=quality.get("scale"),
        manifest=manifest,
        figures=figures,
        compare=_compare(plates),
        trust=_trust(plates),
        relight=viewer.relighting(workspace),
        mesh=viewer.mesh_view(workspace),
        surfaces=SURFACES,
        sections=_sections(quality, figures),
        others=[(name, title) for name, title in _OTHERS if quality.get(name)],
        worst_registration=registration.index(max(registration)) if registration else None,
        changed=_changed_options(manifest["options"]),
        steps=steps,
        times=[(step, manifest["times"][step]) for step in ("photos", "sweep", *steps) if step in manifest["times"]],
        versions=[
            *manifest["versions"].items(),
            ("python", platform.python_version()),
            *((name, metadata.version(name)) for name in ("numpy", "matplotlib")),
            ("system", platform.platform()),
        ],
        version=_core.version,
    )
    with workspace.recording("report") as files:
        for figure in (figure for group in figures.values() for figure in group):
            name = f"report/figures/{figure.name}"
            write_bytes(workspace.folder / f"{name}.png", figure.png())
            write_text(workspace.folder / f"{name}.csv", figure.csv())
            files += [f"{name}.png", f"{name}.csv"]
        files.append("report/index.html")
        write_text(workspace.folder / "report/index.html", page)
    return workspace.folder / "report/index.html"


def open_report(work: str | Path) -> Path:
    """Show the report of a workspace in the web browser; returns the page's path."""
    page = (Path(work) / "report" / "index.html").resolve()
    if not page.is_file():
        raise InputError(f"{page}: there is none; run `malus report {work}` first")
    if not webbrowser.open(page.as_uri()):
        raise ExternalError(f"no web browser could be started; open {page} in one")
    return page
