"""The HTML report of a workspace: one self-contained page with every figure of quality.json."""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
from matplotlib.figure import Figure

from malus import _core, figures
from malus.errors import InputError, ResourceError

#: The surfaces that figures compare, in their order.
SURFACES = ("prior", "polarization", "fused")


def _picture(figure: Figure) -> str:
    return "data:image/png;base64," + base64.b64encode(figures.to_png(figure)).decode()


def _number(value: Any, digits: int = 3) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    return f"{value:.{digits}g}" if abs(value) < 1000 else f"{value:.0f}"


def _read_json(path: Path, missing: str) -> dict[str, Any]:
    try:
        content: dict[str, Any] = json.loads(path.read_text())
        return content
    except FileNotFoundError:
        raise InputError(f"{path}: {missing}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None


def read_quality(work: Path) -> dict[str, Any]:
    """quality.json of a finished workspace."""
    return _read_json(work / "quality.json", "there is none; run `malus assess` or `malus run` first")


def summary_lines(quality: Mapping[str, Any]) -> list[str]:
    """The figures that matter first, a line each, for the terminal."""
    unit = quality["unit"]
    lines = [
        f"{quality['name']}: {quality['method']} fusion, {quality['status']}",
        f"  GSD {_number(quality['gsd'], 4)} {unit}, coverage {100 * quality['coverage']['fraction']:.1f} %",
    ]
    for patch in quality["patches"]:
        fits = {name: patch[name] for name in SURFACES if patch[name] is not None}
        shares = ", ".join(f"{name} {_number(fit['rmse_gsd'])}" for name, fit in fits.items())
        lines.append(f"  patch {patch['name']}: plane RMSE / GSD: {shares}")
    lines += [f"  warning: {warning}" for warning in quality["warnings"]]
    return lines


def write_report(work: str | Path) -> Path:
    """Write WORK/report/index.html from the workspace's rasters and quality.json; returns its path."""
    work = Path(work)
    quality = read_quality(work)
    manifest = _read_json(work / "manifest.json", "there is none; this is not a workspace of malus")
    unit = quality["unit"]
    pictures = {
        "surfaces": _picture(figures.surfaces(work, quality)),
        "polarization": _picture(figures.polarization(work)),
        "height": _picture(figures.height(work, quality)),
        "sigma": _picture(figures.sigma(work, quality)),
    }
    if quality["profiles"]:
        pictures["profile_lines"] = _picture(figures.profile_lines(work, quality["profiles"]))
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["number"] = _number
    template = environment.from_string(resources.files("malus").joinpath("templates/report.html.j2").read_text())
    page = template.render(
        quality=quality,
        manifest=manifest,
        pictures=pictures,
        profiles=[_picture(figures.profile(profile, unit)) for profile in quality["profiles"]],
        histograms=[_picture(figures.histogram(patch)) for patch in quality["patches"]],
        surfaces=SURFACES,
        version=_core.version,
    )
    folder = work / "report"
    target = folder / "index.html"
    temporary = folder / ".index.html.part"
    try:
        folder.mkdir(exist_ok=True)
        with temporary.open("w", encoding="utf-8") as file:
            file.write(page)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(target)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise ResourceError(f"{target}: cannot be written ({error.strerror})") from None
    return target
