"""IIIF folders, read back as viewers do: the manifest by a third-party library, pictures assembled from tiles."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import malus
from conftest import malus_here
from malus import exports, iiif


def test_tiles_of_every_scale_make_up_the_picture(tmp_path: Path) -> None:
    v, u = np.indices((700, 1300))
    picture = np.stack([u * 255 // 1300, v * 255 // 700, 128 + 0 * u], -1).astype(np.uint8)
    info = iiif.write_tiles(tmp_path, picture, "https://x.org/a")
    assert info["tiles"] == [{"width": 512, "height": 512, "scaleFactors": [1, 2, 4]}]
    assert info == json.loads((tmp_path / "info.json").read_text())
    for factor in (1, 2, 4):
        width, height = -(-1300 // factor), -(-700 // factor)
        whole = np.zeros((height, width, 3), np.uint8)
        # The requests of a viewer, by section 4 of the Image API: region in pixels of the full image, size in scaled pixels.
        for y in range(0, 700, 512 * factor):
            for x in range(0, 1300, 512 * factor):
                w, h = min(512 * factor, 1300 - x), min(512 * factor, 700 - y)
                size = -(-w // factor), -(-h // factor)
                region = "full" if (w, h) == (1300, 700) else f"{x},{y},{w},{h}"
                with Image.open(tmp_path / f"{region}/{size[0]},{size[1]}/0/default.jpg") as tile:
                    assert tile.size == size and "icc_profile" in tile.info
                    whole[y // factor : y // factor + size[1], x // factor : x // factor + size[0]] = np.asarray(tile)
        expected = np.asarray(Image.fromarray(picture).resize((width, height), Image.Resampling.LANCZOS))
        assert np.abs(whole.astype(int) - expected).mean() < 2
    with Image.open(tmp_path / "full/max/0/default.jpg") as image:
        assert image.size == (1300, 700)


def test_manifest_is_readable_by_another_library(finished_grid: Path, tmp_path: Path) -> None:
    prezi = pytest.importorskip("iiif_prezi3")
    told = malus_here(
        "export", finished_grid, "--format", "iiif", "--url", "https://x.org/iiif/s/", "-o", tmp_path / "s"
    )
    assert told.code == 0, told.err
    text = (tmp_path / "s/manifest.json").read_text(encoding="utf-8")
    manifest = prezi.Manifest(**json.loads(text))
    assert manifest.label["none"] == ["Relief & label"] and manifest.id == "https://x.org/iiif/s/manifest.json"
    assert [canvas.label["none"][0][:6] for canvas in manifest.items] == ["Photog", "Relief"]
    words = {entry["label"]["none"][0]: entry["value"]["none"][0] for entry in json.loads(text)["metadata"]}
    assert words["Identifier"] == "X 1907.4" and words["License"] == "CC-BY-4.0"
    for canvas in json.loads(text)["items"]:
        body = canvas["items"][0]["items"][0]["body"]
        place = body["id"].removeprefix("https://x.org/iiif/s/")
        with Image.open(tmp_path / "s" / place) as image:
            assert image.size == (canvas["width"], canvas["height"]) == (200, 160)
        info = json.loads((tmp_path / "s" / place.split("/")[0] / "info.json").read_text())
        assert info["id"] == body["service"][0]["id"]
    photograph = np.asarray(Image.open(tmp_path / "s/photograph/full/max/0/default.jpg")).astype(int)
    assert np.abs(photograph - exports.Exporter(malus.Workspace(finished_grid)).picture()).mean() < 4


@pytest.mark.parametrize(
    ("license", "rights"),
    [
        ("https://creativecommons.org/licenses/by-sa/4.0/", "http://creativecommons.org/licenses/by-sa/4.0/"),
        ("https://creativecommons.org/licenses/by/4.0", "http://creativecommons.org/licenses/by/4.0/"),
        ("https://creativecommons.org/licenses/by/4.0/deed.de", "http://creativecommons.org/licenses/by/4.0/"),
        ("https://creativecommons.org/licenses/by/3.0/at/legalcode", "http://creativecommons.org/licenses/by/3.0/at/"),
        ("http://creativecommons.org/publicdomain/zero/1.0/", "http://creativecommons.org/publicdomain/zero/1.0/"),
        ("https://rightsstatements.org/page/InC/1.0/?language=en", "http://rightsstatements.org/vocab/InC/1.0/"),
        ("http://rightsstatements.org/vocab/NoC-US/1.0/", "http://rightsstatements.org/vocab/NoC-US/1.0/"),
        ("CC-BY-4.0", None),
        ("https://museum.org/licenses/by/4.0/", None),
    ],
)
def test_rights_are_the_address_that_the_specification_wants(license: str, rights: str | None) -> None:
    made = iiif.manifest("https://x.org/a", "stone", {"license": license}, [], "")
    assert made.get("rights") == rights


def test_wrong_addresses_and_folders_are_refused(finished_grid: Path, tmp_path: Path) -> None:
    with pytest.raises(malus.InputError, match="--url stone"):
        malus.export(finished_grid, "iiif", tmp_path / "a", url="stone")
    with pytest.raises(malus.InputError, match="is there already"):
        malus.export(finished_grid, "iiif", tmp_path)
    with pytest.raises(malus.InputError, match="--url is for iiif"):
        malus.export(finished_grid, "obj", tmp_path / "a.obj", url="https://x.org")
    assert not list(tmp_path.iterdir())
