"""How a run reacts to inputs that do not belong together: warnings, low confidence, or refusal."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import markupsafe
import pytest
import tifffile

import malus
from conftest import QUICK_WORDS, edit, malus_station
from malus.report import CHECKS
from malus.workspace import Workspace

ANGLES = "angles_deg = [0, 30, 60, 90, 120, 150]"


def findings(work: Path) -> dict[str, dict[str, Any]]:
    return {finding["check"]: finding for finding in json.loads((work / "evidence/findings.json").read_text())}


def test_correct_inputs_give_only_notes(finished_grid: Path) -> None:
    found = findings(finished_grid)
    assert set(found) == {"order", "response", "contrast", "size", "phase", "prior"}
    assert {finding["severity"] for finding in found.values()} == {"note"}
    assert found["order"]["figures"]["misfit_ratio"] < 2
    assert "mm wide" in found["size"]["message"]


def test_every_check_has_a_heading_in_the_report() -> None:
    source = (Path(__file__).parents[2] / "cpp/malus/core/finding.h").read_text()
    names = re.search(r"names_of\(Check\) {[^{]*{([^}]*)}", source)
    assert names is not None and re.findall(r'"(\w+)"', names[1]) == list(CHECKS)


def test_report_has_every_finding(finished_grid: Path) -> None:
    page = (finished_grid / "report/index.html").read_text()
    assert '<section id="checks">' in page
    for finding in Workspace(finished_grid).findings:
        assert markupsafe.escape(finding["message"][1:]) in page


def test_a_warning_is_printed_and_lowers_confidence(small_station: Path, tmp_path: Path) -> None:
    edit(small_station, ANGLES, "angles_deg = [0, 90, 60, 30, 120, 150]")
    work = tmp_path / "work"
    outcome = malus_station(small_station, "-o", work, "--fusion", "grid")
    assert outcome.code == 0, outcome.err
    quality = json.loads((work / "quality.json").read_text())
    assert quality["confidence"]["level"] == "low"
    text = findings(work)["order"]["message"]
    assert "do not seem to be in the order of their angles" in text
    assert outcome.err.count("warning: " + text) == 1
    assert any(text in reason for reason in quality["confidence"]["reasons"])
    assert [warning.split(":")[0] for warning in quality["warnings"] if text in warning] == ["polarization"]


def test_runs_that_end_before_the_evidence_say_what_is_wrong_with_the_images(
    small_station: Path, tmp_path: Path
) -> None:
    edit(small_station, ANGLES, "angles_deg = [0, 90, 60, 30, 120, 150]")
    outcome = malus_station(small_station, "-o", tmp_path / "work", "--until", "polarization")
    assert outcome.code == 0, outcome.err
    assert "do not seem to be in the order of their angles" in outcome.err


def test_a_fault_in_part_of_the_image_makes_confidence_partial(small_station: Path, tmp_path: Path) -> None:
    path = small_station.parent / "pol/pol_060.tif"
    pixels = tifffile.imread(path)
    pixels[20:140, 20:100] //= 2
    tifffile.imwrite(path, pixels)
    work = tmp_path / "work"
    outcome = malus_station(small_station, "-o", work, "--until", "assess", *QUICK_WORDS)
    assert outcome.code == 0, outcome.err
    found = findings(work)["misfits"]
    assert found["severity"] == "caution"
    assert 0.2 < found["figures"]["misfit_fraction"] < 0.5
    assert outcome.err.count("warning: " + found["message"]) == 1
    confidence = json.loads((work / "quality.json").read_text())["confidence"]
    assert confidence["level"] in ("partial", "low")
    assert any(found["message"] in reason for reason in confidence["reasons"])


def test_three_angles_cannot_show_that_the_light_flickered(small_station: Path, tmp_path: Path) -> None:
    edit(small_station, ANGLES, "angles_deg = [0, 60, 120]")
    text = small_station.read_text()
    for angle in ("030", "090", "150"):
        text = re.sub(rf'"[^"]*pol_{angle}[^"]*",? *', "", text)
    small_station.write_text(text.replace(", ]", "]"))
    work = tmp_path / "work"
    options = malus.Options(fusion="grid", capture={"registration": "off"})
    malus.reconstruct(malus.Station.load(small_station), options, workspace=work, until="evidence", threads=1)
    found = findings(work)["misfits"]
    assert found["severity"] == "note" and "whether the light flickered" in found["message"]


def direction_exchanged(station: Path) -> Path:
    return edit(station, ANGLES, ANGLES + '\nangle_direction = "cw"')


@pytest.mark.parametrize("until", ["fuse", "evidence", "assess"])
def test_certainly_wrong_inputs_are_not_fused(small_station: Path, tmp_path: Path, until: str) -> None:
    direction_exchanged(small_station)
    work = tmp_path / "work"
    options = ("--set", "polarizer.calibrate_angles=off", "--fusion", "grid", "--until", until)
    outcome = malus_station(small_station, "-o", work, *options)
    assert outcome.code == 2
    assert "turns against the slopes of the prior" in outcome.err
    assert "expected the other angle_direction" in outcome.err
    assert not (work / "fused").exists()
    assert not (work / "evidence/findings.json").exists()


def test_errors_can_be_overruled_but_not_hidden(small_station: Path, tmp_path: Path) -> None:
    direction_exchanged(small_station)
    work = tmp_path / "work"
    options = ("--set", "polarizer.calibrate_angles=off", "--set", "evidence.refuse=false", "--fusion", "grid")
    outcome = malus_station(small_station, "-o", work, *options)
    assert outcome.code == 0, outcome.err
    assert findings(work)["phase"]["severity"] == "error"
    quality = json.loads((work / "quality.json").read_text())
    assert quality["confidence"]["level"] == "low"
    assert any("turns against the slopes" in reason for reason in quality["confidence"]["reasons"])


def test_the_scene_image_keeps_what_the_mask_excludes(small_station: Path, tmp_path: Path) -> None:
    mask = tifffile.imread(small_station.parent / "pol/pol_000.tif").astype("uint8")
    mask[:] = 0
    mask[20:140, 20:180] = 255
    tifffile.imwrite(small_station.parent / "mask.tif", mask)
    edit(small_station, ANGLES, ANGLES + '\nmask = "mask.tif"')
    work = tmp_path / "work"
    assert malus_station(small_station, "-o", work, "--until", "evidence").code == 0
    scene = tifffile.imread(work / "polarization/scene.tif")
    assert (scene[mask == 0] > 0).mean() > 0.99
