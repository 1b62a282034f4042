"""The HTML report of a workspace: one self-contained page with every figure of quality.json."""

from __future__ import annotations

import platform
import webbrowser
from collections.abc import Mapping, Sequence
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from malus import _core, viewer
from malus._files import resolved, write_bytes, write_text
from malus.columns import aligned, decimals, number
from malus.errors import ExternalError, InputError
from malus.figures import Figure, Plates, histograms, maps, profiles
from malus.glossary import definitions
from malus.lengths import shown, sides
from malus.options import Options
from malus.pages import template
from malus.paper import plates as paper_plates
from malus.paper.tables import table_1
from malus.photo_words import WORDS
from malus.pictures import encode
from malus.relief import gray
from malus.report_head import accuracy_of, head_of
from malus.trust import what_to_trust
from malus.workspace import STEPS, Workspace, WorkspaceGiver, folder_of

#: The surfaces that the report compares, in the order of its tables.
SURFACES = ("prior", "polarization", "fused")
#: Titles of the checks of the inputs, by their names in evidence/findings.json.
CHECKS = {
    "registration": "Registration of the images",
    "order": "Order of the images",
    "encoding": "Encoding of the image files",
    "curve": "Curve of the image files",
    "exposures": "Exposure times of the image files",
    "mask": "Orientation of images and mask",
    "response": "Response of the camera",
    "misfits": "Agreement with the polarizer's sinusoid",
    "angles": "Polarizer angles and exposures",
    "scale": "Zero and direction of the polarizer's scale",
    "polarization": "Polarization in the images",
    "texture": "Texture finer than the mosaic",
    "contrast": "Contrast against the cloud's colors",
    "size": "Size and distance",
    "phase": "Polarization against the prior's slopes",
    "prior": "Place of the prior in the images",
}
#: Parts of quality.json that only some runs have, with their headings; their tables have a row for each number in `WORDS`.
_OTHERS = (("photogrammetry", "Photographs"), ("sweep", "Stereo sweep"))


def confidence_lines(level: str, reasons: Sequence[str], assessed: bool) -> list[str]:
    """The confidence in a surface, and its reasons, one per line; the confidence of a surface that is not assessed yet may still fall."""
    return [f"confidence: {level}{'' if assessed else ', not assessed yet'}", *(f"  {reason}" for reason in reasons)]


def _other_warnings(quality: Mapping[str, Any]) -> list[str]:
    """The warnings that are not among the reasons of the confidence."""
    reasons = quality["confidence"]["reasons"]
    return [warning for warning in quality["warnings"] if not any(warning.endswith(reason) for reason in reasons)]


def summary_lines(quality: Mapping[str, Any], size: tuple[float, float] | None) -> list[str]:
    """The summary for the terminal, as lines; size: of the object, in the station's unit."""
    unit = quality["unit"]
    extent = "" if size is None else f"{sides(size, unit).replace('×', 'x')}, "
    lines = [
        f"{quality['name']}: {extent}{100 * quality['coverage']['fraction']:.1f} % of it covered, "
        f"one pixel is {shown(quality['gsd'], unit)}"
    ]
    accuracy, note = accuracy_of(quality, quality["gsd"])
    lines.append(f"  accuracy: {accuracy} ({note})")
    lines += [f"  {line}" for line in confidence_lines(**quality["confidence"], assessed=True)]
    for patch in quality["patches"]:
        fits = {name: patch[name] for name in SURFACES if patch[name] is not None}
        if not fits:  # a warning says so
            continue
        shares = ", ".join(f"{name} {shown(fit['rmse'], unit)}" for name, fit in fits.items())
        lines.append(f"  flat patch {patch['name']}, distance from a plane (RMSE): {shares}")
    if quality["reference"]:
        distance = quality["reference"]["distance_gsd"]
        if distance["count"] == 0:
            lines.append(f"  distance to the reference: {quality['reference']['status']}")
        else:
            rms, robust = (shown(distance[key] * quality["gsd"], unit) for key in ("rmse", "mad"))
            part = f"{100 * quality['reference']['compared_fraction']:.1f} % of the surface"
            lines.append(f"  distance to the reference, near which {part} lies: RMSE {rms}, robust {robust}")
    lines += [f"  warning: {warning}" for warning in quality["warnings"]] or ["  no warnings"]
    return lines


def _moved_onto(workspace: Workspace) -> str:
    """How the surface was moved onto the reference before the comparison, as the end of a sentence; "" if it was not moved."""
    reference = workspace.quality["reference"]
    if not reference or not reference["alignment_iterations"]:
        return ""
    motion, points = reference["reference_from_surface"], workspace.points()
    middle = points[np.isfinite(points).all(-1)].mean(0)
    rotation = np.array(motion["rotation"]).reshape(3, 3)
    shift = float(np.linalg.norm(motion["scale"] * rotation @ middle + motion["translation"] - middle))
    # Of small angles the cosine has too few digits; the part of a rotation that changes sign when it is transposed has the sine.
    sine = float(np.linalg.norm(rotation - rotation.T)) / 8**0.5
    turn = float(np.degrees(np.arctan2(sine, (np.trace(rotation) - 1) / 2)))
    said = f", to which the surface is moved (its middle by {shown(shift, str(workspace.quality['unit']))}) and turned (by {number(turn, 2)}°)"
    return said + (
        f"; its size is changed by {number(100 * (motion['scale'] - 1), 2)} %"
        if reference["alignment"] == "similarity"
        else ""
    )


def _inside(value: Any, key: str) -> list[Any]:
    """The values of an object or list under a key; "a|b" stands for either of two keys, "*" for all. Empty if there are none."""
    if value is None:
        return []
    items = {str(k): inner for k, inner in enumerate(value)} if isinstance(value, list) else value
    return list(items.values()) if key == "*" else [items[name] for name in key.split("|") if name in items]


class _Quality:
    """Numbers of quality.json by their path ("patches.0.fused.rmse_gsd"), and of m3c2.json ("m3c2.…")."""

    def __init__(self, quality: Mapping[str, Any]) -> None:
        self._quality = quality

    def at(self, path: str) -> Any:
        value: Any = self._quality
        for key in path.split("."):
            value = value[int(key)] if isinstance(value, list) else value[key]
        return value

    def element(self, path: str, digits: int = 3, factor: float = 1, among: str = "") -> Markup:
        """The number in readable form, in an HTML element that also states the exact value and its path.

        `among`: pattern for the paths of all numbers in the same column (a|b: either of two keys, *: any key), which get the same
        number of decimals.
        """
        value = self.at(path)
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if among and is_number:
            text = aligned(value, decimals(self._matching(among), digits))
        else:
            text = number(value * factor if is_number and factor != 1 else value, digits)
        exact = "" if value is None else escape(value)
        return Markup(f'<data value="{exact}" data-path="{escape(path)}">{escape(text)}</data>')

    def _matching(self, pattern: str) -> list[float]:
        found: list[Any] = [self._quality]
        for key in pattern.split("."):
            found = [inner for value in found for inner in _inside(value, key)]
        return [value for value in found if value is not None]

    def named(self, section: str) -> list[tuple[str, str]]:
        """Words and path of every number in a section that `WORDS` has an entry for."""
        return [
            (words, f"{section}.{path}")
            for path, words in WORDS[section].items()
            if self._matching(f"{section}.{path}")
        ]


def _figures(plates: Plates) -> dict[str, list[Figure]]:
    quality = plates.quality
    sections = [profiles.profile_lines(plates), *profiles.profiles(plates)] if quality["profiles"] else []
    return {
        "relief": [*maps.shadings(plates), *maps.elevations(plates)],
        "polarization": [*maps.polarization(plates), *paper_plates.sinusoids(plates)],
        "height": list(maps.height(plates)),
        "profiles": sections,
        "patches": [*paper_plates.patch_boxes(plates), *histograms.patches(plates)],
        "uncertainty": [*paper_plates.cloud(plates), *maps.uncertainty(plates)],
        "reference": list(histograms.reference(plates)),
        "m3c2": list(histograms.m3c2(plates)),
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


def _worst_registration(rms_px: Sequence[float | None]) -> int | None:
    """The image that lies worst on the first one, by its place in the list; None if no image was aligned, as those of a polarization
    camera: the list then holds zeros, which were not measured.
    """
    measured = [rms or 0.0 for rms in rms_px]
    return measured.index(max(measured)) if any(measured) else None


def _term(name: str, text: str | None = None) -> Markup:
    """A term of the glossary, shown as `text` or as the term itself, with its definition on hovering and for screen readers."""
    return Markup('<abbr title="{}">{}</abbr>').format(definitions()[name], text or name)


def _compare(plates: Plates) -> dict[str, bytes]:
    box = plates.object_box()
    return {name: encode(gray(plates.shade(name))[box], "WEBP", quality=90) for name in ("prior", "fused")}


def _trust(plates: Plates) -> bytes | None:
    """The trust map over relief shading: where the surface is refined, and where it is the prior's."""
    if plates.quality["confidence"]["level"] == "low" or not plates.workspace.has("fused/trust.png"):
        return None  # With low confidence, a map that shows trusted parts would contradict the text.
    return encode(maps.trust_picture(plates)[plates.object_box()], "WEBP", quality=85)


def _sections(quality: Mapping[str, Any], figures: Mapping[str, list[Figure]]) -> list[tuple[str, str]]:
    every = [
        ("overview", "Overview"), ("checks", "Checks"), ("compare", "Before and after"), ("explore", "Relight and turn"), ("relief", "Relief"),
        ("polarization", "Polarization"), ("height", "Height"), ("profiles", "Profiles"), ("patches", "Patches"),
        ("uncertainty", "Uncertainty"), ("reference", "Reference"), ("m3c2", "M3C2"), ("scale", "Scale"), ("prior_scale", "Scale of the prior"), ("control", "Control points"), *_OTHERS, ("provenance", "Provenance"),
    ]  # fmt: skip
    optional = ("profiles", "patches", "reference", "scale", "prior_scale", "control", *(name for name, _ in _OTHERS))
    absent = {name for name in optional if not quality.get(name)}
    if not figures["m3c2"]:
        absent.add("m3c2")
    if quality["polarization_height"] is None:
        absent.add("height")
    return [(name, title) for name, title in every if name not in absent]


def write_report(work: str | Path | WorkspaceGiver, output: str | Path | None = None) -> Path:
    """Write the report of a workspace or a result; returns the page's path.

    In a workspace the page is WORK/report/index.html, with its figures as PNG and CSV beside it. With `output`, which a result in
    memory needs, the page alone is written there, too, without links to these files. Raises InputError if a file that the report shows
    was changed after its step wrote it.
    """
    with folder_of(work, output, "an HTML file") as folder:
        return _write(Workspace(folder), None if output is None else Path(output))


def _write(workspace: Workspace, alone: Path | None) -> Path:
    """Write the report in the workspace, and the page alone as the file `alone`, if it is given; returns this page's path, else that of
    the report.
    """
    watch = _core.StepWatch()
    quality, manifest = workspace.quality, workspace.manifest
    plates = Plates(workspace)
    steps = [step for step in STEPS if step in manifest["steps"] and step != "report"]
    figures = _figures(plates)
    m3c2 = workspace.m3c2
    numbers = _Quality({**quality, "m3c2": m3c2})
    mesh = viewer.mesh_view(workspace)
    render = partial(
        template("report.html.j2", {"aligned": aligned}).render,
        q=numbers.element,
        named=numbers.named,
        term=_term,
        head=head_of(plates, mesh["extent"]),
        quality=quality,
        what_to_trust=what_to_trust(quality),
        other_warnings=_other_warnings(quality),
        m3c2=m3c2,
        moved_onto=_moved_onto(workspace),
        findings=workspace.findings,
        checks=CHECKS,
        scale=quality.get("scale"),
        prior_scale=quality.get("prior_scale"),
        control=quality.get("control"),
        manifest=manifest,
        figures=figures,
        compare=_compare(plates),
        trust=_trust(plates),
        relight=viewer.relighting(workspace),
        mesh=mesh,
        surfaces=SURFACES,
        profiles=table_1(workspace, {name: name for name in SURFACES}).without_empty(),
        sections=_sections(quality, figures),
        others=[(name, title) for name, title in _OTHERS if quality.get(name)],
        worst_registration=_worst_registration(quality["registration_rms_px"]),
        changed=_changed_options(manifest["options"]),
        steps=steps,
        times=[(step, manifest["times"][step]) for step in STEPS if step in manifest["times"] and step != "report"],
        versions=[
            *manifest["versions"].items(),
            ("python", platform.python_version()),
            *((name, metadata.version(name)) for name in ("numpy", "matplotlib")),
            ("system", platform.platform()),
        ],
        version=_core.version,
    )
    page = render(has_files=True)
    with workspace.recording("report", watch) as files:
        for figure in (figure for group in figures.values() for figure in group):
            name = f"report/figures/{figure.name}"
            files += [f"{name}.png", f"{name}.csv"]
            write_bytes(workspace.folder / f"{name}.png", figure.png())
            write_text(workspace.folder / f"{name}.csv", figure.csv())
        files.append("report/index.html")
        write_text(workspace.folder / "report/index.html", page)
    if alone is not None:
        write_text(alone, render(has_files=False))
    return alone or workspace.folder / "report/index.html"


def open_report(work: str | Path) -> Path:
    """Show the report of a workspace in the web browser; returns the page's path."""
    page = resolved(Path(work) / "report" / "index.html")
    if not page.is_file():
        Workspace(work).require()
        raise InputError(f"{page}: there is none; run `malus report {work}` first")
    return open_page(page)


def open_page(page: Path) -> Path:
    """Show a file in the web browser; ExternalError if no browser can be started."""
    if not webbrowser.open(resolved(page).as_uri()):
        raise ExternalError(f"no web browser could be started; open {page} in one")
    return page
