"""The archive of a workspace, checked by bagit and read back by rocrate."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import zipfile
from pathlib import Path
from typing import Any

import pytest
import tifffile

import malus
from conftest import edit, malus_here
from malus.archive import _inputs, dublin_core

bagit = pytest.importorskip("bagit")
rocrate = pytest.importorskip("rocrate.rocrate")


@pytest.fixture(scope="module")
def bag(finished_grid: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The unpacked bag."""
    folder = tmp_path_factory.mktemp("archive")
    outcome = malus_here("export", finished_grid, "--format", "archive", "-o", folder / "a.zip")
    assert outcome.code == 0, outcome.err
    with zipfile.ZipFile(folder / "a.zip") as file:
        file.extractall(folder)
    assert {path.name for path in folder.iterdir()} == {"a.zip", "small"}
    return folder / "small"


def entities(bag: Path) -> dict[str, dict[str, Any]]:
    graph = json.loads((bag / "data/ro-crate-metadata.json").read_text(encoding="utf-8"))["@graph"]
    return {entity["@id"]: entity for entity in graph}


def test_bag_is_valid_and_a_changed_byte_is_found(bag: Path, tmp_path: Path) -> None:
    bagit.Bag(str(bag)).validate()
    copy = tmp_path / "copy"
    shutil.copytree(bag, copy)
    depth = copy / "data/results/fused/depth.tif"
    depth.write_bytes(depth.read_bytes()[:-1] + b"x")
    with pytest.raises(bagit.BagValidationError):
        bagit.Bag(str(copy)).validate()


def test_archive_holds_and_describes_every_file(bag: Path, finished_grid: Path) -> None:
    crate = rocrate.ROCrate(str(bag / "data"))
    described = {entity.id for entity in crate.data_entities}
    present = {str(path.relative_to(bag / "data")) for path in (bag / "data").rglob("*") if path.is_file()}
    assert described == present - {"ro-crate-metadata.json"}
    workspace = malus.Workspace(finished_grid)
    assert {f"results/{name}" for name in workspace.outputs} <= present
    assert {f"inputs/{name}" for name in workspace.manifest["inputs"]} <= present
    assert "inputs/station.toml" in present
    known = entities(bag)
    for place in ("results/fused/surface.ply", "inputs/pol/pol_030.tif"):
        content = (bag / "data" / place).read_bytes()
        assert known[place]["sha256"] == hashlib.sha256(content).hexdigest()


def test_archive_has_catalog_entries_and_paradata(bag: Path, finished_grid: Path) -> None:
    known = entities(bag)
    assert known["./"]["license"] == "CC-BY-4.0"
    assert known["#object"]["name"] == "Relief & label" and known["#object"]["identifier"] == "X 1907.4"
    assert "<dc:title>Relief &amp; label</dc:title>" in (bag / "data/metadata/dublin_core.xml").read_text()
    assert "External-Identifier: X 1907.4" in (bag / "bag-info.txt").read_text()
    workspace = malus.Workspace(finished_grid)
    for name, step in workspace.manifest["steps"].items():
        action = known[f"#step-{name}"]
        assert action["@type"] == "CreateAction" and action["agent"] == {"@id": "#recorded-by"}
        results = action["result"] if isinstance(action["result"], list) else [action["result"]]
        assert {entry["@id"] for entry in results} == {f"results/{output}" for output in step["outputs"]}
        # The profile's validator accepts ISO 8601 with at most three decimals of a second.
        assert all(re.fullmatch(r"[-\d]{10}T[\d:]{8}\.\d{3}\+00:00", action[f"{end}Time"]) for end in ("start", "end"))
        assert action["startTime"] <= action["endTime"]
        assert name in action["description"]
        assert not [key for key, value in action.items() if isinstance(value, list) and len(value) == 1]
    settings = {entity["name"]: entity["value"] for key, entity in known.items() if key.startswith("#setting-")}
    assert json.loads(settings["height.smoothness"]) == workspace.options().height.smoothness
    assert known["#OpenCV"]["softwareVersion"].startswith("4.")


def test_the_catalog_record_has_every_entry() -> None:
    """The date of the recording was missing."""
    known = {"title": "Stone & label", "date": "1907", "recorded_on": "2026-05-01", "material": "marl"}
    record = dublin_core("small", known)
    assert "<dc:date>1907</dc:date>" in record and "<dc:date>2026-05-01</dc:date>" in record
    assert "<dc:title>Stone &amp; label</dc:title>" in record and "<dc:format>marl</dc:format>" in record


def test_names_are_escaped_in_addresses_only(tiny_station: Path, tmp_path: Path) -> None:
    """Notes on a photograph had its name, with blanks, in their address, which JSON-LD does not allow."""
    folder = tiny_station.parent / "pol"
    photograph = folder / "Büste 1.tif"
    model = (272, "s", 0, "Camera One", True)
    tifffile.imwrite(photograph, tifffile.imread(folder / "pol_000.tif"), extratags=[model])
    edit(tiny_station, "pol/pol_000.tif", "pol/Büste 1.tif")
    work = tmp_path / "work"
    malus.reconstruct(malus.Station.load(tiny_station), malus.Options(fusion="grid"), workspace=work)
    with zipfile.ZipFile(malus.export(work, "archive")) as file:
        file.extractall(tmp_path)
    assert (tmp_path / "small/data/inputs/pol/Büste 1.tif").read_bytes() == photograph.read_bytes()
    known = entities(tmp_path / "small")
    assert all(re.fullmatch(r"[!-~]+", address) for address in known)
    described = known["inputs/pol/B%C3%BCste%201.tif"]
    assert described["name"] == "inputs/pol/Büste 1.tif"
    assert known[described["exifData"]["@id"]]["value"] == "Camera One"


def test_changed_or_missing_inputs_are_refused(
    tiny_station: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    work, image = tmp_path / "work", tiny_station.parent / "pol/pol_030.tif"
    (tiny_station.parent / "camera").mkdir()
    content = image.rename(tiny_station.parent / "camera/30.tif").read_bytes()
    image.symlink_to("../camera/30.tif")
    os.utime(image, (0, 0))  # as from a camera whose clock was never set; dates in ZIP begin in 1980
    malus.reconstruct(malus.Station.load(tiny_station), malus.Options(fusion="grid"), workspace=work)
    with zipfile.ZipFile(malus.export(work, "archive", tmp_path / "a.zip")) as file:
        assert file.read("small/data/inputs/pol/pol_030.tif") == content, "what the link leads to"

    def changed_before(folder: str, *arguments: Any, **options: Any) -> Any:
        (Path(folder) / "inputs/pol/pol_000.tif").write_bytes(b"another")
        return make_bag(folder, *arguments, **options)

    make_bag = bagit.make_bag
    first = (image.parent / "pol_000.tif").read_bytes()
    monkeypatch.setattr(bagit, "make_bag", changed_before)
    with pytest.raises(malus.InputError, match=r"pol_000\.tif: was changed while it was packed"):
        malus.export(work, "archive")
    (image.parent / "pol_000.tif").write_bytes(first)
    said = tiny_station.read_text()
    edit(tiny_station, 'unit = "mm"', 'unit = "m"')
    with pytest.raises(malus.InputError, match=r"station\.toml: was changed since"):
        malus.export(work, "archive")
    tiny_station.write_text(said)
    cloud = tiny_station.parent / "dense/cloud.ply"
    content = cloud.read_bytes()
    cloud.write_bytes(content + b" ")
    with pytest.raises(malus.InputError, match=r"cloud\.ply: was changed since"):
        malus.export(work, "archive")
    cloud.unlink()
    with pytest.raises(malus.InputError, match=r"cloud\.ply: is not there any more"):
        malus.export(work, "archive")
    assert not list(work.glob("export/**/*"))


def test_a_changed_object_description_recomputes_nothing(tiny_station: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    assert malus_here("assess", tiny_station, "-o", work, "--fusion", "grid").code == 0
    before = malus.Workspace(work).manifest["times"]
    edit(tiny_station, 'maker = "unknown mason"', 'maker = "Phidias"')
    assert malus_here("assess", tiny_station, "-o", work, "--fusion", "grid").code == 0
    after = malus.Workspace(work)
    assert after.quality["object"]["maker"] == "Phidias"
    assert after.manifest["times"]["fuse"] == before["fuse"]
    edit(tiny_station, "maker =", "makr =")
    outcome = malus_here("check", tiny_station)
    assert outcome.code == 2 and "[object].makr" in outcome.err and "maker" in outcome.err


def test_files_that_a_station_made_in_code_names_are_inputs(
    small_station: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They were called arrays, and left out."""
    said = malus.Station.load(small_station).describe()
    images = [tifffile.imread(path) for path in said["images"]]
    camera = malus.Camera.from_description(said["camera"])
    monkeypatch.chdir(small_station.parent)
    station = malus.Station(
        images, said["angles_deg"], camera, polarized={"white_level": 16383}, prior={"cloud": "dense/cloud.ply"}
    )
    monkeypatch.chdir(tmp_path)
    malus.reconstruct(station, until="prior", workspace=tmp_path / "work", threads=1)
    inputs = _inputs(malus.Workspace(tmp_path / "work"))
    clouds = [file for name, file in inputs.items() if name.endswith("dense/cloud.ply")]
    assert len(clouds) == 1 and clouds[0] is not None
    assert clouds[0].path.samefile(small_station.parent / "dense/cloud.ply")
    assert inputs["images[0]"] is None and len(inputs) == 7
    with (small_station.parent / "dense/cloud.ply").open("ab") as cloud:
        cloud.write(b"0")
    with pytest.raises(malus.InputError, match="was changed since the surface was made from it"):
        _inputs(malus.Workspace(tmp_path / "work"))
