"""The report: every number is from quality.json, nothing comes from the network, the interactive views show the rasters' data."""

from __future__ import annotations

import base64
import csv
import io
import json
import re
import shutil
import zlib
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image

import malus
from conftest import malus_here, run_program
from malus import _core, figures, lengths, pages, viewer
from malus import raster as raster_module
from malus import relief as relief_module
from malus.columns import MINUS, aligned, decimals, number, plain
from malus.figures import maps, profiles
from malus.report import _moved_onto, _worst_registration
from malus.report_head import accuracy_of, covered_of, finishes_of, gains_of, gains_title
from malus.trust import what_to_trust
from view_scale import drawn_mm, page_in_browser, pixel_mm, turning_view


class Page(HTMLParser):
    """The parts of the page that the tests check: its data elements, addresses, ids, images without a description, JSON blocks."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.numbers: list[tuple[str, str, str]] = []
        self.addresses: list[str] = []
        self.ids: list[str] = []
        self.bare_images = 0
        self.blocks: dict[str, str] = {}
        self._number: dict[str, str | None] | None = None
        self._block: str | None = None
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.addresses += [value for key, value in attrs if key in ("src", "href") and value]
        if values.get("id"):
            self.ids.append(str(values["id"]))
        if tag == "img" and not values.get("alt"):
            self.bare_images += 1
        if tag == "data":
            self._number = values
        if tag == "script" and values.get("type") == "application/json":
            self._block = values["id"]

    def handle_data(self, data: str) -> None:
        if self._number is not None:
            self.numbers.append((str(self._number["data-path"]), str(self._number["value"]), data))
            self._number = None
        if self._block is not None:
            self.blocks[self._block] = data
            self._block = None


@pytest.fixture(scope="module")
def work(finished_grid: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report") / "work"
    shutil.copytree(finished_grid, folder)
    return folder


@pytest.fixture(scope="module")
def page(work: Path) -> Page:
    return Page((work / "report/index.html").read_text())


def at(quality: object, path: str) -> object:
    for key in path.split("."):
        quality = quality[int(key)] if isinstance(quality, list) else quality[key]  # type: ignore[index]
    return quality


def test_every_number_is_that_of_quality_json(work: Path, page: Page) -> None:
    quality = json.loads((work / "quality.json").read_text())
    paths = {path for path, _, _ in page.numbers}
    assert {
        "gsd",
        "coverage.fraction",
        "patches.0.fused.rmse_gsd",
        "patches.0.prior.rmse_gsd",
        "sigma.median_gsd",
    } <= paths
    for path, exact, text in page.numbers:
        value = at(quality, path)
        if value is None:
            assert (exact, text) == ("", "–"), path
            continue
        assert float(exact) == value, path
        # The text is the value, or a hundred times the value as percent, rounded to its last digit.
        read = float(text.replace(MINUS, "-"))
        half = 0.5000001 * 10.0 ** -len(text.partition(".")[2])
        assert any(abs(read - v) <= half for v in (value, 100 * value)), path


def test_numbers_of_a_column_have_equally_many_decimals() -> None:
    places = decimals([0.0441, 1.828, None])
    assert [aligned(value, places) for value in (0.0441, 1.828, None)] == ["0.044", "1.828", "–"]
    assert [aligned(value, decimals([8520, 12])) for value in (8520, 12)] == ["8520", "12"]
    assert aligned(-0.2, decimals([-0.2, 0.14], 2)) == f"{MINUS}0.20"
    assert aligned(-0.0004, 2) == "0.00"
    assert decimals([]) == decimals([0.0, float("nan")]) == 0


def test_no_number_is_written_with_an_exponent() -> None:
    assert [number(value, 2) for value in (150.4, 99.7, -0.067, 12345, True, None, 6e-5, 0.0, 1e-17)] == [
        "150", "100", f"{MINUS}0.067", "12345", "yes", "–", "0.000060", "0", "0",
    ]  # fmt: skip
    # Square millimeters of a wall's changed part, and cubic ones of a scratch.
    assert [plain(value) for value in (2.1e6, -1.234e-5, 12.345, 0.0)] == ["2100000", f"{MINUS}0.0000123", "12.3", "0"]


def classes_by_row(text: str, heading: str) -> list[list[tuple[str, str]]]:
    """Class and text of every cell of the body of the table after a heading."""
    body = text[text.index(heading) :].partition("<tbody>")[2].partition("</tbody>")[0]
    rows = [re.findall(r"<td(?: class=\"(\w+)\")?>(.*?)</td>", row) for row in body.split("</tr>")]
    return [row for row in rows if row]


def test_profile_numbers_are_right_aligned_and_empty_columns_left_out(work: Path) -> None:
    text = (work / "report/index.html").read_text()
    rows = classes_by_row(text, "Each surface on each profile")
    assert [row[1][1] for row in rows] == ["prior", "polarization", "fused"]
    for columns, expected in ((slice(2), ""), (slice(2, None), "n")):
        assert {kind for row in rows for kind, _ in row[columns]} == {expected}
    assert len(rows[0]) == 6 and "error [" not in text, "there is no reference"
    for column in range(4, 6):
        assert len({len(row[column][1].partition(".")[2]) for row in rows}) == 1, column


def test_solver_terms_appear_only_among_the_parameters(work: Path) -> None:
    told, provenance = (work / "report/index.html").read_text().split('<section id="provenance"')
    assert "converged" in provenance and "converged" not in told
    assert "The direction to the light is" in told


def test_page_is_self_contained_and_described(work: Path, page: Page) -> None:
    for address in page.addresses:
        if address.startswith(("data:", "#")):
            continue
        assert re.fullmatch(r"figures/[a-z0-9_]+\.(png|csv)", address), address
        assert (work / "report" / address).is_file(), address
    assert page.bare_images == 0
    assert len(page.ids) == len(set(page.ids))
    for section in (
        "overview",
        "compare",
        "explore",
        "relief",
        "polarization",
        "height",
        "profiles",
        "patches",
        "uncertainty",
    ):
        assert section in page.ids and f"#{section}" in page.addresses, section
    assert (work / "report/index.html").stat().st_size < 4e6


def test_figures_lie_beside_the_page_with_their_numbers(work: Path) -> None:
    folder = work / "report/figures"
    pictures = {path.stem for path in folder.glob("*.png")}
    assert pictures == {path.stem for path in folder.glob("*.csv")}
    quality = json.loads((work / "quality.json").read_text())
    with (folder / "profile_1.csv").open() as file:
        rows = list(csv.DictReader(file))
    profile = quality["profiles"][0]
    assert [float(row["position_mm"]) for row in rows] == profile["position"]
    assert [float(row["fused_mm"]) for row in rows] == profile["fused"]
    with (folder / "patch_1.csv").open() as file:
        counts = [int(row["count"]) for row in csv.DictReader(file) if row["surface"] == "fused"]
    assert counts == quality["patches"][0]["fused"]["histogram_gsd"]["counts"]
    with (folder / "degree.csv").open() as file:
        row = next(csv.DictReader(file))
    degree = tifffile.imread(work / "polarization/degree.tif")
    assert float(row["p50"]) == pytest.approx(np.nanmedian(degree), rel=1e-6)


def test_report_begins_with_photograph_confidence_size_accuracy_and_gain(work: Path) -> None:
    text = (work / "report/index.html").read_text()
    places = [
        text.index(part)
        for part in (
            "Photograph of",
            "<dt>Confidence",
            "<dt>Size",
            "<dt>Accuracy",
            'class="verdict',
            "the coarse surface alone",
        )
    ]
    assert places == sorted(places)
    quality = json.loads((work / "quality.json").read_text())
    accuracy = lengths.shown(quality["sigma"]["median_gsd"] * quality["gsd"], "mm")
    assert f"<dt>Accuracy</dt><dd>{accuracy} " in text and accuracy.endswith(" µm")


def test_no_gain_is_claimed_where_the_surface_is_the_priors(work: Path) -> None:
    quality = json.loads((work / "quality.json").read_text())
    assert gains_of(quality, "mm")
    kept = quality | {"refinement": {"trusted_share": 0.01}, "confidence": {"level": "partial", "reasons": []}}
    assert gains_of(kept, "mm") == []
    assert "no finer and no worse" in what_to_trust(kept)


@pytest.mark.parametrize(
    ("size", "unit", "said"),
    [
        ((12300, 8000), "um", "12.3 × 8.0 mm"),
        ((218.4, 150), "mm", "218 × 150 mm"),
        ((1.234, 0.9), "m", "1.23 × 0.90 m"),
        ((0.02, 0.01), "in", "508 × 254 µm"),
    ],
)
def test_sizes_are_rounded_for_reading(size: tuple[float, float], unit: str, said: str) -> None:
    assert lengths.sides(size, unit) == said


def figures_of(level: str, **other: object) -> dict[str, object]:
    """The part of quality.json that the report's head reads, for a run with this confidence."""
    patch = {"name": "1", "prior": {"rmse": 0.2}, "fused": {"rmse": 0.05}}
    return {
        "unit": "mm", "gsd": 0.1, "sigma": {"median_gsd": 0.6, "p95_gsd": 2.0}, "patches": [patch], "prior_vs_fused": None,
        "confidence": {"level": level, "reasons": ["Because."]}, "prior": {"filled_fraction": 0.01}, **other,
    }  # fmt: skip


def test_accuracy_is_qualified_where_confidence_is_low() -> None:
    assert accuracy_of(figures_of("high"), 0.1)[0] == "60 µm"
    said, note = accuracy_of(figures_of("low"), 0.1)
    assert said == "at best 60 µm" and "in doubt" in note
    for unknown in (None, {"median_gsd": None, "p95_gsd": None}):  # of no pixel: NaN in C++
        assert accuracy_of(figures_of("partial", sigma=unknown), 0.1)[0] == "not known"


def test_the_accuracy_is_that_of_the_surface_not_of_the_object() -> None:
    """A part of the object without a surface has no standard deviation."""
    assert "on 95 % of the surface below 200 µm" in accuracy_of(figures_of("high"), 0.1)[1]


def test_the_alignment_with_the_reference_is_told_at_the_surface() -> None:
    """Far from the origin the translation alone says nothing: half a degree about it moves the surface by kilometers."""
    far = np.array([5e5, 5.4e6, 300])
    angle = np.radians(0.5)
    rotation = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    motion = {"scale": 1.004, "rotation": rotation.ravel().tolist()}
    motion["translation"] = (far + (0.003, 0, 0.004) - 1.004 * rotation @ far).tolist()
    reference = {"alignment": "similarity", "alignment_iterations": 7, "reference_from_surface": motion}
    points = np.full((2, 2, 3), np.nan)
    points[0] = far + np.array([[1, 2, 3], [-1, -2, -3]])

    def told(**other: object) -> str:
        quality = {"unit": "m", "reference": {**reference, **other}}
        return _moved_onto(SimpleNamespace(quality=quality, points=lambda: points))

    assert told() == (
        ", to which the surface is moved (its middle by 5 mm) and turned (by 0.5°); its size is changed by 0.4 %"
    )
    assert told(alignment="rigid").endswith("turned (by 0.5°)")
    assert told(alignment="rigid", alignment_iterations=0) == ""


def test_a_change_is_not_called_gain_where_evidence_contradicts_it() -> None:
    rougher = {"name": "2", "prior": {"rmse": 0.05}, "fused": {"rmse": 0.2}}
    as_before = {"name": "3", "prior": {"rmse": 0.05}, "fused": {"rmse": 0.05}}
    assert "was gained" in gains_title(figures_of("partial"))
    for quality in (
        figures_of("low"),
        figures_of("high", patches=[rougher]),
        figures_of("high", patches=[as_before]),
        figures_of("high", patches=[]),
    ):
        assert gains_title(quality) == "What fusion changed against the coarse surface alone"
    assert "4 times rougher" in gains_of(figures_of("high", patches=[rougher]), "mm")[0]


def test_a_patch_of_a_prior_that_is_an_exact_plane_is_compared_without_a_number() -> None:
    """A plane as the coarse surface has an RMSE of 0 there: the report ended in a ZeroDivisionError."""
    for before, after, said in (
        (0.0, 0.02, "is rougher: 20 µm"),
        (0.0, 0.0, "is as flat as before: 0 µm"),
        (0.02, 0.0, "is flatter: 0 µm"),
        (1e-5, 0.02, "is 2000 times rougher: 20 µm"),
    ):
        patch = {"name": "1", "prior": {"rmse": before}, "fused": {"rmse": after}}
        (line,) = gains_of(figures_of("high", patches=[patch]), "mm")
        assert said in line
        assert ("was gained" in gains_title(figures_of("high", patches=[patch]))) == (before > after)


def test_two_finishes_are_described_in_a_sentence() -> None:
    def told(usual: float, other: float, share: float) -> str:
        found = {"roughness": usual, "other_roughness": other, "other_finish_share": share}
        return finishes_of(figures_of("high", refinement={"surroundings": found}))

    assert told(0.05, 0.525, 0.106).endswith("about 11 % of it is duller than the rest (roughness 0.53 against 0.05).")
    assert "about 30 % of it is glossier than the rest (roughness 0.1 against 0.4)" in told(0.4, 0.1, 0.3)
    assert "bare clay: less than 1 % of it is duller" in told(0.05, 0.5, 0.004), "not about 0 %"
    assert told(0.05, 0, 0) == ""
    for one in ({}, {"refinement": None}, {"refinement": {"surroundings": None}}):
        assert finishes_of(figures_of("high", **one)) == ""


def test_the_report_contains_the_sentence_about_finishes(
    work: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(work, tmp_path / "work")
    monkeypatch.setattr("malus.report_head.finishes_of", lambda _quality: "It has two finishes.")
    malus.write_report(tmp_path / "work")
    text = (tmp_path / "work/report/index.html").read_text()
    assert "<p>It has two finishes.</p>" in text.split("<h3>In numbers</h3>")[0]


def test_areas_without_a_coarse_surface_are_not_called_measured() -> None:
    assert covered_of(figures_of("high")) == "of the object's pixels have a surface"
    assert "on 40 % the coarse one has no data" in covered_of(figures_of("partial", prior={"filled_fraction": 0.4}))


@pytest.mark.parametrize(
    ("level", "refined", "said"),
    [
        ("high", 0.97, "can be trusted on nearly all"),
        ("partial", 0.95, "is likely on nearly all of the object. The reasons below"),
        ("partial", 0.6, "blue-green (60 % of the object)"),
        ("partial", 0.01, "no finer and no worse"),
        ("partial", None, "Nothing proves the fine detail"),
        ("low", 0.95, "Do not rely on this surface"),
    ],
)
def test_what_can_be_trusted_is_stated_in_a_sentence(level: str, refined: float | None, said: str) -> None:
    quality = figures_of(level, refinement={"trusted_share": refined})
    assert said in what_to_trust(quality)


def test_what_is_refined_is_told_as_a_share_of_the_object() -> None:
    """The refinement's share is one of the pixels with usable polarization: half of this object is saturated, and a fifth of the
    rest mirrors the object itself.
    """
    refined = {"trusted_share": 0.92}
    quality = figures_of("partial", refinement=refined, polarization={"valid_fraction": 0.5})
    assert "blue-green (46 % of the object)" in what_to_trust(quality)
    quality["refinement"] = {**refined, "surroundings": {"self_mirroring_share": 0.2}}
    assert "blue-green (37 % of the object)" in what_to_trust(quality)


def test_alternative_texts_describe_the_pictures(work: Path) -> None:
    alternatives = re.findall(r'<img [^>]*alt="([^"]*)"', (work / "report/index.html").read_text())
    assert all(len(text.split()) >= 5 for text in alternatives), alternatives
    assert len(set(alternatives)) == len(alternatives)
    degree = next(text for text in alternatives if text.startswith("Degree of linear polarization"))
    median = np.nanmedian(tifffile.imread(work / "polarization/degree.tif"))
    assert f"half of them below {median:.3g}" in degree


@pytest.mark.parametrize(
    ("length", "unit", "said"),
    [
        (0.0604, "mm", "60 µm"),
        (1.26, "mm", "1.3 mm"),
        (218, "mm", "218 mm"),
        (0.003, "in", "76 µm"),
        (3.2, "m", "3.2 m"),
        (0.0996, "mm", "100 µm"),
        (99.7, "m", "100 m"),
        (-0.0996, "mm", f"{MINUS}100 µm"),
        (3e-8, "mm", "0.000030 µm"),
    ],
)
def test_lengths_are_rounded_for_reading(length: float, unit: str, said: str) -> None:
    assert lengths.shown(length, unit) == said


@pytest.mark.parametrize(
    ("extent", "unit", "bar"),
    [(218, "mm", (50, "50 mm")), (0.9, "m", (0.2, "200 mm")), (12, "mm", (2, "2 mm")), (400, "um", (100, "100 µm"))],
)
def test_scale_bars_are_round_and_about_a_fifth(extent: float, unit: str, bar: tuple[float, str]) -> None:
    length, label = lengths.scale_bar(extent, unit)
    assert (length, label) == (pytest.approx(bar[0]), bar[1])


def test_scale_of_a_section_leaves_out_single_spikes() -> None:
    wave = np.sin(np.arange(500) / 7)
    assert profiles._without_spikes([wave, 2 * wave]) is None
    spiked = wave.copy()
    spiked[250] = 300
    spiked[251] = np.nan
    low, high = profiles._without_spikes([spiked]) or (0, 0)
    assert low == pytest.approx(-1, abs=0.01) and 2 < high < 4
    assert profiles._without_spikes([]) is None


def test_detail_of_a_section_excludes_its_form() -> None:
    along = np.arange(200.0)
    wave = np.sin(along / 2)
    section = 0.3 * along - 40 + wave
    section[60:64] = np.nan
    detail = profiles.without_form(section, 8)
    assert np.isnan(detail[60:64]).all()
    np.testing.assert_allclose(detail[90:-40], wave[90:-40], atol=0.05)
    bent = 0.3 * along - 40 + 0.02 * (along - 90) ** 2
    np.testing.assert_allclose(profiles.without_form(bent, 8), 0, atol=1e-8)
    bent[[*range(1, 80), *range(82, 200)]] = np.nan  # one sample by itself, then two
    np.testing.assert_allclose(profiles.without_form(bent, 8)[[0, 80, 81]], 0, atol=1e-4)


def unpack(text: str) -> np.ndarray:
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8).astype(np.int64)
    low, high = np.split(planes, 2)
    return (np.cumsum(low + 256 * high) & 0xFFFF).astype(np.uint16)


def test_relighting_data_are_the_fused_normals(work: Path, page: Page) -> None:
    data = json.loads(page.blocks["relight-data"])
    assert (data["width"], data["height"], data["step"]) == (200, 160, 1)
    normals = tifffile.imread(work / "fused/normals.tif")
    right, up = unpack(data["fused"]).view(np.int16).reshape(2, 160, 200) / data["scale"]
    np.testing.assert_allclose(right, normals[..., 0], atol=0.6 / data["scale"])
    np.testing.assert_allclose(up, -normals[..., 1], atol=0.6 / data["scale"])
    slope = normals[..., :2] * (1, -1) / -normals[..., 2:]
    np.testing.assert_allclose(data["median_slope"], np.median(slope.reshape(-1, 2), axis=0), atol=1e-5)


def test_mesh_data_are_the_depth_map(work: Path, page: Page) -> None:
    data = json.loads(page.blocks["mesh-data"])
    positions = unpack(data["positions"]).reshape(3, -1) / 65535 * data["size"]
    depth = tifffile.imread(work / "fused/depth.tif")
    assert data["extent"][2] == pytest.approx(float(depth.max() - depth.min()), rel=1e-3)
    u, v = unpack(data["uv"]).reshape(2, -1) / 65535 * np.array([[200], [160]]) - 0.5
    nearest = depth[np.rint(v).astype(int), np.rint(u).astype(int)]
    np.testing.assert_allclose(positions[2].max() - positions[2], nearest - depth.min(), atol=2e-3)


def test_blue_is_in_front_in_the_map_of_what_fusion_changed(work: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in the maps of distances from a reference and of changes; it was red."""
    plates = figures.Plates(malus.Workspace(work))
    own = plates.raster
    monkeypatch.setattr(
        plates, "raster", lambda name: own("prior/depth.tif") - 1 if name == "fused/depth.tif" else own(name)
    )
    (change,) = (figure for figure in maps.uncertainty(plates) if figure.name == "fused_minus_prior")
    red, _, blue = change.picture[change.picture.shape[0] // 3, change.picture.shape[1] // 2].astype(int)
    assert blue > red + 40 and "Negative (blue)" in change.caption


@pytest.mark.parametrize(("limits", "ends"), [((0, 9), "neither"), ((1, 9), "min"), ((0, 8), "max"), ((1, 8), "both")])
def test_color_bars_show_where_values_lie_beyond_them(limits: tuple[float, float], ends: str) -> None:
    drawing = figures.drawing.new_drawing(4, 3)
    values = np.append(np.arange(9.0), [np.nan, 9]).reshape(1, -1)
    picture = drawing.add_axes((0, 0.3, 1, 0.7)).imshow(values, vmin=limits[0], vmax=limits[1])
    figures.drawing.color_bar(drawing, picture, "mm")
    assert picture.colorbar is not None and picture.colorbar.extend == ends


@pytest.mark.parametrize("values", [(6e-6, 6e-5), (1000.01, 1000.21), (2e6, 9e6)])
def test_axes_have_complete_numbers(values: tuple[float, float]) -> None:
    """A color bar in meters said 2, 4 and 6: the factor of 1e-5 lay below the picture, and so did the offset of depths."""
    drawing = figures.drawing.new_drawing(4, 3)
    axes = drawing.add_axes((0, 0.3, 1, 0.7))
    figures.drawing.color_bar(drawing, axes.imshow([values]), "m")
    sections = drawing.add_axes((0.2, 0.4, 0.5, 0.5))
    sections.plot(values, values)
    figures.drawing.style(sections)
    figures.drawing.drawn(drawing)
    for axis in (drawing.axes[1].xaxis, sections.xaxis, sections.yaxis):
        shown = [float(label.get_text().replace(MINUS, "-")) for label in axis.get_ticklabels()]
        np.testing.assert_allclose(shown, axis.get_ticklocs(), rtol=1e-6, atol=1e-9)


def test_reduced_rasters_average_only_valid_pixels() -> None:
    raster = np.array([[1, 3, 10], [np.nan, 5, np.nan]], np.float32)
    np.testing.assert_allclose(raster_module.reduced(raster, 2), [[3, 10]])
    assert np.isnan(raster_module.reduced(np.full((2, 2), np.nan, np.float32), 2)).all()


@pytest.mark.parametrize(("slope", "azimuth", "brighter"), [(0.3, 90, False), (0.3, 270, True), (-0.3, 90, True)])
def test_hillshade_is_linear_in_the_cosine_to_the_light(slope: float, azimuth: float, brighter: bool) -> None:
    relief = np.tile(slope * 2.0 * np.arange(20, dtype=np.float32), (15, 1))
    relief[3, 4] = np.nan
    shade = relief_module.hillshade(relief, 2.0, azimuth, 50)
    sign = 1 if brighter else -1
    angle = np.arctan(abs(slope))
    black = np.sin(np.radians(20))
    expected = (np.sin(np.radians(50) + sign * angle) + black) / (1 + black)
    np.testing.assert_allclose(shade[np.isfinite(relief)], expected, rtol=1e-3)
    assert np.isnan(shade[3, 4])


def test_large_stations_are_downsampled(monkeypatch: pytest.MonkeyPatch, work: Path) -> None:
    monkeypatch.setattr(viewer, "NORMALS_SIDE_PX", 64)
    monkeypatch.setattr(viewer, "MESH_TRIANGLES", 2000)
    workspace = malus.Workspace(work)
    data = json.loads(json.dumps(viewer.relighting(workspace)))
    assert (data["step"], data["width"], data["height"]) == (4, 50, 40)
    assert data["gsd"] == pytest.approx(4 * workspace.quality["gsd"])
    image = Image.open(io.BytesIO(base64.b64decode(data["color"])))
    assert image.size == (50, 40)
    assert viewer.mesh_view(workspace)["triangles"] <= 2200


class Wire:
    """A result: an upright wire, three pixels wide. Of every second pixel no two lie beside each other on it."""

    def surface(self) -> malus.fusion.FusedSurface:
        depth = np.full((100, 100), np.nan, np.float32)
        depth[:, 1:4] = 10
        normals = np.zeros((100, 100, 3), np.float32)
        normals[..., 2] = -1
        camera = malus.Camera("PINHOLE", 100, 100, [1000.0, 1000.0, 49.5, 49.5])
        return malus.fusion.FusedSurface(depth, normals, np.full((100, 100), 1e-3, np.float32), camera)

    def options(self) -> malus.Options:
        return malus.Options()


def test_parts_thinner_than_the_meshs_cells_do_not_end_the_report(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer, "MESH_TRIANGLES", 10)
    assert len(viewer._page_mesh(Wire()).triangles) == 2 * 2 * 99


@pytest.fixture
def edited(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files that a test puts into a workspace count as if a step had left them."""
    monkeypatch.setattr(malus.Workspace, "path", lambda self, name: self.folder / name)
    monkeypatch.setattr(malus.Workspace, "has", lambda self, name: (self.folder / name).is_file())


@pytest.fixture
def copied(edited: None, finished_grid: Path, tmp_path: Path) -> tuple[Path, dict[str, Any]]:
    """A workspace that may be changed, and its figures."""
    work = shutil.copytree(finished_grid, tmp_path / "work")
    return work, json.loads((work / "quality.json").read_text())


def reported(work: Path, quality: dict[str, Any]) -> str:
    """The page of a workspace with these figures."""
    (work / "quality.json").write_text(json.dumps(quality))
    malus.write_report(work)
    return (work / "report/index.html").read_text()


def test_color_images_are_shown_in_color(copied: tuple[Path, dict[str, Any]]) -> None:
    work, _ = copied
    intensity = tifffile.imread(work / "polarization/unpolarized.tif")
    tifffile.imwrite(
        work / "polarization/color.tif", np.stack([intensity, 0.6 * intensity, 0.3 * intensity], -1), photometric="rgb"
    )
    workspace = malus.Workspace(work)
    for picture in (
        malus.exports.Exporter(workspace).picture(),
        np.array(Image.open(io.BytesIO(base64.b64decode(viewer.relighting(workspace)["color"])))),
    ):
        red, green, blue = picture[..., :3].reshape(-1, 3).mean(0)
        assert red > 1.15 * green > 1.3 * blue


def test_scale_and_photos_are_shown_when_they_are_known(copied: tuple[Path, dict[str, Any]]) -> None:
    work, quality = copied
    bar = {
        "name": "bar <1>",
        "check": True,
        "distance": 31.504,
        "adjusted": 31.5071,
        "residual": 0.0031,
        "sigma": 0.009,
    }
    bar |= {"rms_px": 0.12, "worst_px": 0.31, "worst_image": "view_03.jpg"}
    quality["scale"] = {
        "status": "converged", "scale": 12.5, "sigma": 0.004, "unit_weight": 1.07, "redundancy": 5,
        "distances": [bar, {**bar, "name": "bar 2", "check": False}],
    }  # fmt: skip
    fit = {"name": "P<1>", "check": False, "offset": [0.1, -0.2, 0.3], "rms_px": 0.4}
    quality["control"] = {
        "datum": {"sigma": 0.21, "check_rms": 0.347, "doubtful": "P<1>", "points": [fit]},
        "image": {
            "use": "check", "rms_px": 1.25, "check_rms_px": None, "center_sigma": None, "doubtful": None,
            "points": [{"name": "T", "check": True, "du_px": 1.5, "dv_px": None}],
        },
    }  # fmt: skip
    quality["photogrammetry"] = {"program": "COLMAP 3.8", "registered": 12, "station": {"matches": 345}}
    text = reported(work, quality)
    shown = {path: text for path, _, text in Page(text).numbers}
    assert shown["scale.distances.0.residual"] == "0.0031" and shown["scale.distances.0.adjusted"] == "31.5071"
    assert shown["photogrammetry.station.matches"] == "345" and shown["photogrammetry.program"] == "COLMAP 3.8"
    assert shown["control.datum.points.0.offset.1"] == "−0.20" and shown["control.image.points.0.du_px"] == "1.5"
    assert shown["control.datum.check_rms"] == "0.35" and "the check points to" not in text
    assert "matches of the polarized image with the photos" in text and "station.matches</td>" not in text
    assert "without point P&lt;1&gt;" in text and "check the camera's pose" in text
    assert "From 1 known distance; 1 more checks it: the size of everything is known to 0.032 % (standard dev" in text
    assert "standard deviation, from 1 known distance<" in text
    assert "bar &lt;1&gt;" in text and "bar <1>" not in text


def test_without_height_from_polarization_the_reason_is_stated(copied: tuple[Path, dict[str, Any]]) -> None:
    """With a light beside the lens, an empty map was shown as a height that was still changing."""
    work, quality = copied
    height = tifffile.imread(work / "height/height.tif")
    tifffile.imwrite(work / "height/height.tif", np.full_like(height, np.nan))
    quality["polarization_height"] |= {"status": "light along the view direction", "light_to_view_deg": 0.8}
    for profile in quality["profiles"]:
        profile["polarization"] = [None] * len(profile["polarization"])
    quality["method"] = "refined"
    quality["refinement"] = {
        "refractive_index": {"value": 1.5, "sigma": 0, "stated": None}, "trusted_share": 0.95, "specular_share": 0.9,
        "metal": {"refractive_index": [0.63, 3.19], "intensity_error": 0.1}, "lobe": None, "iterations": [],
        "surroundings": {"roughness": 0.1, "other_roughness": 0, "other_finish_share": 0},
    }  # fmt: skip
    text = reported(work, quality)
    section = text.split('<section id="height">')[1].split("</section>")[0]
    assert "There is none: light along the view direction." in section and "still changing" not in section
    assert "0.8</data>° from the view direction" in section and "<figure" not in section
    # The index 1.5 of a dielectric has no part in a metal's surface.
    index = text.split(">refractive index</abbr>")[1].split("</tr>")[0]
    assert re.sub("<.*?>", "", index) == "about 0.63 + 3.19 i, a metal's"
    quality["refinement"]["metal"]["stated"] = {"intensity_error": 0.1, "stokes_cost": 1, "dielectric_stokes_cost": 1}
    index = reported(work, quality).split(">refractive index</abbr>")[1].split("</tr>")[0]
    assert re.sub("<.*?>", "", index) == "0.63 + 3.19 i, of the stated metal"


def test_what_nothing_tells_is_not_shown_as_given(copied: tuple[Path, dict[str, Any]]) -> None:
    """The zero of the polarizer's scale, and a refractive index."""
    work, quality = copied
    quality["refinement"] = {
        "refractive_index": {"value": 1.5, "sigma": None, "stated": None}, "trusted_share": 0.95, "specular_share": 0,
        "metal": None, "lobe": {"strength": 0}, "iterations": [], "surroundings": None,
    }  # fmt: skip
    quality["polarizer"] |= {"zero_error_deg": None, "zero_error_sigma_deg": None, "surface_check": "nothing to see"}
    text = reported(work, quality)
    index = text.split(">refractive index</abbr>")[1].split("</tr>")[0]
    assert re.sub("<.*?>", "", index) == "1.5, assumed"
    assert "is right could not be checked: nothing to see." in text and "–°" not in text


def test_names_in_any_script_can_be_read(finished_grid: Path, recwarn: pytest.WarningsRecorder) -> None:
    """Pictures had boxes in place of Chinese letters and Hebrew ones in the wrong order, and quality.json in the page had escapes."""
    plates = figures.Plates(malus.Workspace(finished_grid))
    plates.quality["profiles"][0]["name"] = "剖面 1"
    assert "the name stands at the start. (1) is 剖面 1." in profiles.profile_lines(plates).caption
    assert not any("Glyph" in str(warning.message) for warning in recwarn)
    assert figures.drawing.names_in_picture(["front", "חזית", "Größe"]) == (["front", "(2)", "Größe"], " (2) is חזית.")
    shown = pages.template("campaign.html.j2").environment.from_string("{{ said | tojson }}")
    assert shown.render(said={"b": "青銅鏡", "a": "<"}) == '{"b": "青銅鏡", "a": "\\u003c"}'


def test_images_that_were_not_aligned_have_no_residual() -> None:
    """The report called images of a polarization camera, and those of capture.registration = off, aligned to 0 px."""
    assert _worst_registration([0.0, 0.0, 0.0]) is None and _worst_registration([None, None]) is None
    assert _worst_registration([0.0, 0.02, None, 0.01]) == 1


def test_text_of_charts_is_not_cut_off(work: Path) -> None:
    chart = np.asarray(Image.open(work / "report/figures/sinusoids.png").convert("L"))
    assert chart[:, -2:].min() > 200 and chart[:2].min() > 200


def test_report_and_view_say_what_is_missing(tmp_path: Path) -> None:
    outcome = malus_here("report", tmp_path / "none")
    assert outcome.code == 2 and "there is no such folder" in outcome.err
    (tmp_path / "manifest.json").write_text("{}")
    outcome = malus_here("view", tmp_path)
    assert outcome.code == 2 and "malus report" in outcome.err


def test_a_step_that_does_not_exist_is_not_recorded(tmp_path: Path) -> None:
    with pytest.raises(malus.InputError, match="step nothing does not exist"):
        _core.record_step(str(tmp_path), "nothing", [], "{}")
    assert not list(tmp_path.iterdir())


def test_a_page_whose_surface_changed_meanwhile_is_not_kept(work: Path, tmp_path: Path) -> None:
    """Another run changes the surface between reading it and recording the page."""
    folder = shutil.copytree(work, tmp_path / "work")
    workspace = malus.Workspace(folder)
    with (
        pytest.raises(malus.InputError, match="changed by another run meanwhile"),
        workspace.recording("report") as files,
    ):
        (folder / "report/index.html").write_text("of the old surface")
        files.append("report/index.html")
        _core.forget_step(str(folder), "assess")
    assert not (folder / "report/index.html").exists()
    assert "report" not in malus.Workspace(folder).manifest["steps"]


def test_a_page_that_fails_beside_another_leaves_no_record_without_files(work: Path, tmp_path: Path) -> None:
    """Two programs make the page at once: the one that failed removed the files that the other one had recorded."""
    folder = shutil.copytree(work, tmp_path / "work")
    with (
        pytest.raises(RuntimeError, match="no room"),
        malus.Workspace(folder).recording("report") as files,
    ):
        files.append("report/index.html")
        with malus.Workspace(folder).recording("report") as others:
            (folder / "report/index.html").write_text("of the other program")
            others.append("report/index.html")
        raise RuntimeError("no room")
    assert not malus.Workspace(folder).has("report/index.html")
    assert not (folder / "report/index.html").exists()


def test_view_opens_the_page(work: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or True)
    page = malus.report.open_report(work)
    assert opened == [page.as_uri()] and page == (work / "report/index.html").resolve()
    monkeypatch.setattr("webbrowser.open", lambda address: False)
    with pytest.raises(malus.ExternalError, match="no web browser"):
        malus.report.open_report(work)


def _luminance(color: str) -> float:
    channels = [int(color[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    linear = [value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4 for value in channels]
    return float(np.dot(linear, (0.2126, 0.7152, 0.0722)))


def test_text_contrasts_with_every_background() -> None:
    """Contrast of 4.5 (WCAG 2 AA) on light and dark pages."""
    themes = re.findall(r":root \{(.*?)\}", pages.asset("report.css"), re.DOTALL)[:2]
    for theme in themes:
        colors = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", theme))
        for letters in ("ink", "soft", "accent", "good", "partial", "low"):
            for ground in ("paper", "page", "warn-paper"):
                low, high = sorted(_luminance(colors[name]) for name in (letters, ground))
                assert (high + 0.05) / (low + 0.05) >= 4.5, (letters, ground)


def test_scale_bars_fit_the_scale_of_their_pictures(work: Path) -> None:
    """On a low screen, on paper, and where the trust map stands beside many reasons."""
    measured = """() => [...document.querySelectorAll('.bar')].map((bar) => {
      const image = bar.parentElement.querySelector('img'), frame = image.getBoundingClientRect(), own = bar.getBoundingClientRect();
      const shown = Math.min(frame.width, frame.height * image.naturalWidth / image.naturalHeight);
      return [own.width / shown, parseFloat(bar.style.width) / 100, own.left >= frame.left && own.bottom <= frame.bottom + 1];
    })"""
    with page_in_browser(work / "report/index.html", 1280, 450) as page:
        page.evaluate(
            "() => { const verdict = document.querySelector('.verdict');"
            " verdict.append(document.querySelector('.photograph .scaled').cloneNode(true));"
            " verdict.querySelector('.reasons ul').innerHTML = '<li>reason</li>'.repeat(30); }"
        )
        for medium in ("screen", "print"):
            page.emulate_media(media=medium)
            bars = page.evaluate(measured)
            assert len(bars) == 3
            for share, said, within in bars:
                assert share == pytest.approx(said, rel=0.02) and within, (medium, bars)


def test_a_long_name_makes_the_page_no_wider_than_a_phone(work: Path, tmp_path: Path) -> None:
    text = (work / "report/index.html").read_text()
    name = malus.Workspace(work).quality["name"]
    long = "Inventarnummer_1893_4711_Fragment_eines_Reliefs_mit_Inschrift_und_Rosette"
    (tmp_path / "index.html").write_text(text.replace(f"<bdi>{name}</bdi>", f"<bdi>{long}</bdi>"))
    with page_in_browser(tmp_path / "index.html", 390, 844) as page:
        assert page.get_by_role("heading", name=long).count() == 1
        assert page.evaluate("document.documentElement.scrollWidth") == 390


def test_the_scale_of_the_turning_view_follows_zoom(work: Path) -> None:
    text = (work / "report/index.html").read_text()
    width, height, depth = json.loads(text.split('id="mesh-data">')[1].split("</script>")[0])["extent"]
    with turning_view(work / "report/index.html", "mesh") as view:
        home = pixel_mm(view)
        across, down = drawn_mm(view)
        # The view is turned by 18 degrees to the side and somewhat upwards.
        assert across == pytest.approx(0.94 * width + 0.3 * depth, rel=0.1)
        assert down == pytest.approx(0.98 * height + 0.2 * depth, rel=0.15)
        view.get_by_role("button", name="Zoom out").click()
        assert pixel_mm(view) == pytest.approx(1.5 * home, rel=2e-3)
        assert drawn_mm(view) == pytest.approx([across, down], rel=0.03)
        view.locator("canvas").focus()
        view.page.keyboard.press("+")
        assert pixel_mm(view) == pytest.approx(1.5 / 1.25 * home, rel=2e-3)
        view.get_by_role("button", name="Reset").click()
        assert pixel_mm(view) == pytest.approx(home, rel=2e-3)


def test_views_start_in_a_browser(work: Path, tmp_path: Path) -> None:
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("chromium is not installed")
    outcome = run_program(
        chromium, "--headless", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
        "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", f"--user-data-dir={tmp_path}",
        "--virtual-time-budget=20000", "--dump-dom", (work / "report/index.html").resolve().as_uri(),
    )  # fmt: skip
    assert '<div class="view ready" id="relight">' in outcome.out, outcome.err
    assert '<div class="view ready" id="mesh">' in outcome.out, outcome.err
    assert "Light from 313° (clockwise from up)" in outcome.out
