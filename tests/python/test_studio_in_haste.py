"""Studio's page and users who act before its answers arrive, go to another part or change their minds."""

from __future__ import annotations

import io
import os
import re
import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from malus.pictures import encode
from studio_browser import (
    Served,
    brought,
    chromium,
    draw,
    go,
    held,
    hurry,
    let_go,
    needs_browser,
    needs_studio,
    opened,
    require_accessible,
    studio,
    wait_for,
)

pytestmark = [needs_studio, needs_browser]

#: A station file for the folder's images, cameras and cloud.
STATION = """[station]
name = "museum"
unit = "mm"

[polarized]
images = "pol"
angles_deg = [0, 30, 60, 90, 120, 150]

[camera]
colmap_model = "sparse"
image = "station.jpg"

[prior]
cloud = "dense/cloud.ply"
"""


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory, small_station_source: Path) -> Iterator[Served]:
    with studio(brought(small_station_source, tmp_path_factory.mktemp("studio") / "museum")) as running:
        yield running


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as started:
        yield started


@pytest.fixture
def station(served: Served) -> Iterator[Path]:
    """The file of a test's own station."""
    file = served.folder / "station.toml"
    file.write_text(STATION)
    yield file
    for made in served.folder.glob("station*"):
        made.unlink()


@pytest.fixture
def page(served: Served, browser: Any, station: Path) -> Iterator[Any]:
    """A page of the test's own, in which its station is open."""
    with opened(browser, served) as shown:
        open_station(shown, station.name)
        yield shown


def open_station(page: Any, name: str) -> None:
    go(page, "Images")
    page.get_by_role("button", name=f"Open {name}").click()
    page.locator("#station").wait_for(state="visible")
    page.locator("main:not([aria-busy])").wait_for()
    page.locator("#plan", has_text="Ready").wait_for()


def test_a_change_that_cannot_be_saved_is_not_shown_as_saving(page: Any, station: Path) -> None:
    page.route("**/api/set", lambda route: route.fulfill(status=400, json={"error": "no room on the disk"}))
    page.get_by_label("Coarse surface (prior)").select_option("")
    page.locator("#message", has_text="no room on the disk").wait_for()
    page.locator("#plan", has_text="Ready").wait_for()
    assert page.get_by_label("Coarse surface (prior)").input_value() == "cloud:dense/cloud.ply"


def test_long_names_make_no_part_wider_than_a_phone(page: Any, served: Served, station: Path) -> None:
    long = "station_Inventarnummer_1893_4711_Fragment_eines_Reliefs_mit_Inschrift_und_Rosette"
    images = shutil.copytree(served.folder / "pol", served.folder / long)
    patch = f'\n[[patch]]\nname = "{long}"\nbox = [20, 20, 60, 60]\n'
    (station.parent / f"{long}.toml").write_text(STATION.replace('"pol"', f'"{long}"') + patch)
    page.set_viewport_size({"width": 390, "height": 844})
    open_station(page, f"{long}.toml")
    for part in ("Station", "Draw", "Options", "Run"):
        if part == "Draw":
            draw(page, "patch")
            page.locator("#draw-side legend", has_text=long).wait_for()
        else:
            go(page, part)
        assert page.evaluate("document.documentElement.scrollWidth") == 390, part
    shutil.rmtree(images)


def test_of_quick_changes_only_the_last_is_checked(page: Any, station: Path) -> None:
    kept = held(page, "check")
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url) if "/api/check" in request.url else None)
    for level in ("60000", "61000", "62000"):
        page.evaluate("document.getElementById('plan').textContent = ''")  # until the check of this change
        page.get_by_label("White level").fill(level)
        page.get_by_label("White level").press("Tab")
        page.locator("#plan", has_text="Checking").wait_for()
    assert len(asked) == 1
    let_go(page, kept)
    page.locator("#plan", has_text="Ready").wait_for()
    assert len(asked) == 2


def test_text_typed_while_an_answer_is_awaited_stays(page: Any, station: Path) -> None:
    kept = held(page, "set")
    place = page.get_by_role("textbox", name="Name of the object")
    place.fill("Quick")
    level = page.get_by_label("White level")
    level.click()  # takes the focus from the name
    level.press_sequentially("60")
    let_go(page, kept)
    page.locator("#station-text").evaluate(
        "text => new Promise(done => { const look = () => text.value.includes('Quick') ? done() : setTimeout(look, 20); look(); })"
    )
    level.press_sequentially("000")
    level.press("Tab")
    wait_for(page, lambda: "white_level = 60000" in station.read_text())
    assert 'name = "Quick"' in station.read_text()
    wait_for(page, lambda: level.get_attribute("value") == "60000")
    # Text that was typed completely before the answer came is a change, too.
    kept = held(page, "set")
    place.fill("Slow")
    level.click()
    level.fill("")
    let_go(page, kept)
    wait_for(page, lambda: place.get_attribute("value") == "Slow")
    level.press("Tab")
    wait_for(page, lambda: "white_level" not in station.read_text())
    assert 'name = "Slow"' in station.read_text()
    wait_for(page, lambda: not level.get_attribute("value"))
    # A selection stays, too: the next key replaces the selected text.
    kept = held(page, "set")
    level.fill("50000")
    place.select_text()  # takes the focus from the level
    let_go(page, kept)
    wait_for(page, lambda: level.get_attribute("value") == "50000")
    page.keyboard.insert_text("Marked")
    kept = held(page, "set")
    level.select_text()  # takes the focus from the name
    let_go(page, kept)
    wait_for(page, lambda: place.get_attribute("value") == "Marked")
    page.keyboard.insert_text("70000")
    page.keyboard.press("Tab")
    wait_for(page, lambda: "white_level = 70000" in station.read_text())
    assert 'name = "Marked"' in station.read_text()


def test_lines_typed_into_a_description_while_an_answer_is_awaited_stay(page: Any, station: Path) -> None:
    page.get_by_text("For the catalog").click()
    kept = held(page, "set")
    page.get_by_role("textbox", name="Name of the object").fill("Quick")
    place = page.get_by_label("Description")
    place.click()  # takes the focus from the name
    place.press_sequentially("Two\n")
    let_go(page, kept)
    wait_for(page, lambda: 'name = "Quick"' in page.locator("#station-text").input_value())
    place.press_sequentially("lines")
    place.press("Tab")
    wait_for(page, lambda: tomllib.loads(station.read_text()).get("object") == {"description": "Two\nlines"})
    require_accessible(page)


def test_the_last_of_several_quick_choices_counts(served: Served, page: Any) -> None:
    from playwright.sync_api import expect

    for name in ("Images", "Station", "Draw", "Options", "Station", "Run", "Draw"):
        hurry(page, name)
    page.locator("main:not([aria-busy])").wait_for()
    assert page.evaluate("[...document.querySelectorAll('main > section')].filter(one => !one.hidden).map(one => one.id)") == ["draw"]  # fmt: skip
    assert page.evaluate("document.querySelectorAll('#draw, #draw [inert]').length") == 1
    assert page.locator("[data-tool=move]").count() == 1
    # A folder whose answer comes late does not replace the folder that was chosen after it.
    go(page, "Images")
    page.get_by_role("button", name="pol (6 images)").wait_for()
    kept = held(page, "folder")
    page.get_by_role("button", name=re.compile(r"^views \(")).click()
    wait_for(page, lambda: bool(kept))
    page.get_by_role("button", name="pol (6 images)").click()
    page.get_by_alt_text("Phase in a circle of colors").wait_for()
    let_go(page, kept)
    page.wait_for_timeout(300)
    expect(page.locator("#crumbs")).to_contain_text("pol")
    expect(page.locator("#angles tbody tr")).to_have_count(6)
    # Two presses make one station.
    page.get_by_label("File", exact=True).fill("twice.toml")
    page.get_by_role("button", name="Create the station").dblclick()
    page.locator("#station").wait_for(state="visible")
    page.locator("main:not([aria-busy])").wait_for()
    assert page.locator("#open-station").text_content() == "twice.toml"
    assert not page.locator("#message").text_content()
    (served.folder / "twice.toml").unlink()


TWO_PATCHES = """
[[patch]]
name = "first"
box = [10, 10, 30, 30]

[[patch]]
name = "second"
box = [40, 40, 60, 60]
"""


def add(page: Any, station: Path, text: str) -> None:
    """Append text to the station's file as another program would, and show it in the page."""
    station.write_text(station.read_text() + text)
    go(page, "Station")


def test_two_changes_of_a_list_at_once_are_both_made(page: Any, station: Path) -> None:
    add(page, station, TWO_PATCHES)
    draw(page, "patch")
    kept = held(page, "set")
    for name in ("first", "second"):
        page.get_by_role("group", name=f"patch {name}").get_by_role("button", name="Remove").click()
    page.get_by_role("button", name="Add one by numbers").click()
    let_go(page, kept)
    page.get_by_role("group", name="patch 1").wait_for()
    wait_for(page, lambda: "[80, 64, 120, 96]" in station.read_text())
    assert "first" not in station.read_text() and "second" not in station.read_text()


def test_a_list_that_another_program_changed_is_not_overwritten(page: Any, station: Path) -> None:
    add(page, station, TWO_PATCHES)
    draw(page, "patch")
    station.write_text(station.read_text().replace("second", "theirs"))
    page.get_by_role("group", name="patch first").get_by_role("button", name="Remove").click()
    page.locator("#message", has_text="please make your last change once more").wait_for()
    page.get_by_role("group", name="patch first").get_by_role("button", name="Remove").click()
    page.get_by_role("group", name="patch first").wait_for(state="detached")
    page.get_by_role("group", name="patch theirs").wait_for()
    assert "theirs" in station.read_text() and "first" not in station.read_text()


def test_an_image_chosen_while_another_one_is_loading_can_be_drawn_on(page: Any) -> None:
    kept = held(page, "size")
    go_on = page.get_by_role("banner").get_by_role("button", name="Draw", exact=True)
    go_on.click()
    wait_for(page, lambda: bool(kept))
    # Chosen by a script, as by the keyboard: an inert element takes no pointer.
    page.locator("#draw-image").evaluate("one => { one.selectedIndex = 2; one.dispatchEvent(new Event('change')); }")
    let_go(page, kept)
    page.locator("main:not([aria-busy])").wait_for()
    wait_for(page, lambda: page.locator("#draw [inert]").count() == 0)


def test_nothing_is_marked_while_another_image_is_loading(page: Any, station: Path) -> None:
    go(page, "Station")
    page.get_by_label("Photographs from all around").select_option("views")
    wait_for(page, lambda: "views" in station.read_text())
    draw(page, "scale")
    page.get_by_role("button", name="Add a known distance").click()
    page.get_by_role("button", name="Mark end a").click()
    page.get_by_role("button", name="Mark end a", pressed=True).wait_for()
    kept = held(page, "size")
    page.locator("#draw-image").select_option("views/view_04.jpg")
    wait_for(page, lambda: bool(kept))
    box = page.locator("#draw-stage").bounding_box()
    assert box
    page.mouse.click(box["x"] + 300, box["y"] + 200)  # on the photo that is still shown
    let_go(page, kept)
    page.locator("#draw-stage:not([inert])").wait_for()
    page.locator("#draw-stage").click(position={"x": 100, "y": 100})
    page.get_by_text(re.compile(r"in \d photos: .*view_04.jpg")).wait_for()
    go(page, "Draw")
    page.get_by_role("button", name="Undo the last change").click()
    wait_for(page, lambda: "view_04" not in station.read_text())  # there was one mark only


def test_nothing_is_painted_during_the_search_for_the_edge(page: Any) -> None:
    draw(page, "mask")
    stage = page.locator("#draw-stage")
    page.locator("[data-tool=brush]").click()
    stage.drag_to(stage, source_position={"x": 200, "y": 200}, target_position={"x": 300, "y": 260})
    kept = held(page, "cut")
    page.get_by_role("button", name="Find the edge").click()
    wait_for(page, lambda: bool(kept))
    assert stage.evaluate("stage => stage.inert")
    let_go(page, kept)
    page.locator("#draw-stage:not([inert])").wait_for()


def test_a_tool_chosen_by_the_keyboard_keeps_the_focus(page: Any) -> None:
    draw(page, "patch")
    page.locator("[data-tool=box]").focus()
    page.keyboard.press("Enter")
    page.locator("[data-tool=box][aria-pressed=true]").wait_for()
    assert page.evaluate("document.activeElement.dataset.tool") == "box"


def test_a_step_of_undo_that_fails_is_not_lost(page: Any, station: Path) -> None:
    place = page.get_by_role("textbox", name="Name of the object")
    kept = held(page, "model")  # the page requests it while it shows the change
    place.fill("Other")
    place.press("Tab")
    wait_for(page, lambda: bool(kept))
    page.route("**/api/text", lambda route: route.fulfill(status=400, json={"error": "no room on the disk"}))
    page.get_by_role("button", name="Undo the last change").click()
    page.locator("#message", has_text="no room on the disk").wait_for()
    let_go(page, kept)
    page.locator("#plan", has_text="Ready").wait_for()
    assert page.locator("#message").text_content() == "no room on the disk"
    page.unroute("**/api/text")
    page.get_by_role("button", name="Undo the last change").click()
    wait_for(page, lambda: "Other" not in station.read_text())
    page.locator("#redo:not([disabled])").wait_for()


def test_text_being_typed_into_the_station_file_stays(page: Any, station: Path) -> None:
    text = page.locator("#station-text")
    page.locator("summary", has_text="The station file").click()
    kept = held(page, "set")
    place = page.get_by_role("textbox", name="Name of the object")
    place.fill("Quick")
    place.press("Tab")
    text.press("Control+End")
    text.press_sequentially("# typed meanwhile")
    let_go(page, kept)
    wait_for(page, lambda: "Quick" in station.read_text())
    wait_for(page, lambda: page.locator("#fields input").first.input_value() == "Quick")
    assert text.input_value().endswith("# typed meanwhile") and "Quick" not in text.input_value()
    # The file has changed since the typing began: the page says so before the text replaces the file.
    save = page.locator("#save-text")
    save.click()
    page.locator("#message", has_text="What you have typed still stands here").wait_for()
    assert "Quick" in station.read_text() and "typed" not in station.read_text()
    save.click()
    wait_for(page, lambda: "# typed meanwhile" in station.read_text())
    assert "Quick" not in station.read_text()


def test_the_station_that_was_opened_last_stays_open(served: Served, page: Any, station: Path) -> None:
    other = served.folder / "station_other.toml"
    other.write_text(STATION)
    kept = held(page, "set")
    place = page.get_by_role("textbox", name="Name of the object")
    place.fill("Quick")
    place.press("Tab")
    go(page, "Images")
    page.get_by_role("button", name=f"Open {other.name}").click()
    page.wait_for_timeout(300)
    let_go(page, kept)
    wait_for(page, lambda: "Quick" in station.read_text())
    page.locator("#open-station", has_text=other.name).wait_for()
    page.locator("#plan", has_text="Ready").wait_for()
    assert page.locator("#open-station").text_content() == other.name
    assert "Quick" not in other.read_text()


def test_a_press_during_which_an_answer_arrives_still_counts(page: Any, station: Path) -> None:
    add(page, station, TWO_PATCHES)
    draw(page, "patch")
    kept = held(page, "set")
    field = page.get_by_role("group", name="patch first").get_by_label("name")
    field.fill("mine")
    removing = page.get_by_role("group", name="patch second").get_by_role("button", name="Remove").bounding_box()
    assert removing
    page.mouse.move(removing["x"] + 5, removing["y"] + 5)
    page.mouse.down()  # takes the focus from the field
    let_go(page, kept)
    wait_for(page, lambda: "mine" in station.read_text())
    page.wait_for_timeout(300)
    page.mouse.up()
    wait_for(page, lambda: "second" not in station.read_text())
    assert "mine" in station.read_text()


def test_angles_typed_before_the_file_names_are_read_stay(page: Any) -> None:
    go(page, "Images")
    kept = held(page, "angles")
    page.get_by_role("button", name="pol (6 images)").click()
    typed = page.get_by_label("Angle of pol_030.tif")
    typed.fill("33")
    typed.press("Tab")
    let_go(page, kept)
    page.get_by_alt_text("Phase in a circle of colors").wait_for()
    assert page.get_by_label("Angle of pol_060.tif").input_value() == "60"
    assert typed.input_value() == "33"


def test_a_failed_check_is_reported(page: Any, station: Path) -> None:
    page.route("**/api/check*", lambda route: route.fulfill(status=400, json={"error": "no room on the disk"}))
    place = page.get_by_role("textbox", name="Name of the object")
    place.fill("Other")
    place.press("Tab")
    page.locator("#plan", has_text="could not be checked").wait_for()


def test_a_preview_of_another_folder_is_not_shown(page: Any) -> None:
    go(page, "Images")
    kept = held(page, "preview")
    page.get_by_role("button", name="pol (6 images)").click()
    wait_for(page, lambda: bool(kept))
    page.get_by_role("button", name="opened folder: museum").click()
    page.get_by_role("button", name="views (3 images)").click()
    page.locator("#preview .warning").wait_for()
    let_go(page, kept)
    page.wait_for_timeout(300)
    assert page.locator("#preview .warning").count() == 1


def test_the_surface_shown_upon_the_image_is_that_of_the_station_file(page: Any, station: Path) -> None:
    show = page.get_by_role("button", name="Show the coarse surface on the image")
    show.click()
    page.locator("#overlay-note", has_text="Yellow is near").wait_for()
    cameras = page.get_by_label("Cameras (COLMAP model)")
    cameras.select_option("")
    page.locator("#overlay-stage").wait_for(state="hidden")
    cameras.select_option("sparse")
    page.locator("#plan", has_text="Ready").wait_for()
    for late in ("overlay", "size"):  # "size" is for the image below the surface
        kept = held(page, late)
        show.click()
        wait_for(page, lambda kept=kept: bool(kept))
        cameras.select_option("")
        page.locator("#plan", has_text="cannot run yet").wait_for()
        let_go(page, kept)
        page.wait_for_timeout(300)
        assert not page.locator("#overlay-note").text_content() and page.locator("#overlay-stage").is_hidden()
        cameras.select_option("sparse")
        page.locator("#plan", has_text="Ready").wait_for()


def test_a_late_message_about_another_mark_is_dropped(page: Any, station: Path) -> None:
    add(page, station, '\n[photos]\nfolder = "views"\n\n[[scale]]\ndistance = 10\na = []\nb = []\n')
    draw(page, "scale")
    kept: list[Any] = []
    page.route("**/api/marks", lambda route: fulfil_marks(route, "of b") if kept else kept.append(route))
    page.get_by_role("button", name="Mark end a").click()
    wait_for(page, lambda: bool(kept))
    page.get_by_role("button", name="Mark end b").click()
    side = page.locator("#draw-side")
    side.get_by_text("of b").wait_for()
    fulfil_marks(kept[0], "of a")
    page.wait_for_timeout(300)
    assert side.get_by_text("of b").count() == 1 and side.get_by_text("of a").count() == 0


def fulfil_marks(route: Any, said: str) -> None:
    route.fulfill(json={"problem": said, "lines": [], "fits": {}})


#: A run as the server describes it to the page.
RUN = {
    "number": 1, "title": "museum", "state": "waiting", "fraction": 0, "step": "", "message": "", "seconds_left": None, "steps": {},
    "error": "", "work": "station_work", "report": None, "asked": {"name": "run", "body": {}},
}  # fmt: skip


def test_a_button_keeps_the_focus_when_its_run_begins(page: Any) -> None:
    run = dict(RUN)
    page.route("**/api/runs*", lambda route: route.fulfill(json=[run]))
    go(page, "Run")
    page.get_by_role("button", name="Cancel").focus()
    run["state"] = "running"
    page.locator("p[data-state]", has_text="starting").wait_for()
    assert page.evaluate("document.activeElement.textContent") == "Cancel"


def test_unreadable_results_can_be_scrolled_to_by_the_keyboard(page: Any) -> None:
    broken = [
        {"path": f"work_{k}", "problem": f"manifest.json: no results of a run ({'broken ' * 20})"} for k in (1, 2)
    ]
    page.route("**/api/results*", lambda route: route.fulfill(json=broken))
    page.set_viewport_size({"width": 390, "height": 844})
    go(page, "Results")
    require_accessible(page)


def test_an_earlier_list_of_runs_that_comes_late_is_dropped(page: Any) -> None:
    going = {**RUN, "number": 2, "work": "other_work", "state": "running"}
    runs = [{**RUN, "state": "canceled"}, going]
    kept: list[Any] = []

    answered = 0

    def answer(route: Any) -> None:
        nonlocal answered
        answered += 1
        if answered == 2:
            kept.append(route)  # the page asks again while a run goes on
        else:
            route.fulfill(json=runs)

    page.route("**/api/runs*", answer)
    page.route("**/api/run", lambda route: route.fulfill(json={"number": 3}))
    go(page, "Run")
    wait_for(page, lambda: bool(kept))
    earlier = list(runs)
    runs[:] = [going, {**RUN, "number": 3}]
    page.get_by_role("button", name="Resume").press("Enter")
    page.locator("[data-run='3']").wait_for()
    kept[0].fulfill(json=earlier)
    page.wait_for_timeout(300)
    shown = page.locator("#run-list article").evaluate_all("cards => cards.map(card => card.dataset.run)")
    assert shown == ["3", "2"]
    assert page.evaluate("document.activeElement.closest('article').dataset.run") == "3"


#: A result of the station that most tests open.
RESULT = {
    "path": "work", "name": "museum", "unit": "mm", "gsd": 0.1, "width": 200, "height": 160, "method": "grid", "status": "converged",
    "confidence": {"level": "high", "reasons": []}, "warnings": [], "coverage": 1, "sigma_gsd": None, "report": None,
    "station": "station.toml",
}  # fmt: skip


def test_a_profile_is_kept_in_the_station_of_its_result_only(served: Served, page: Any) -> None:
    (served.folder / "station_b.toml").write_text(STATION)
    results = [{**RESULT, "station": "station_b.toml"}]
    page.route("**/api/results*", lambda route: route.fulfill(json=results))
    page.route("**/api/relief*", lambda route: route.fulfill(body=encode(np.zeros((160, 200), np.uint8), "PNG")))
    page.route("**/api/profile", lambda route: route.fulfill(json=section_to(100)))
    go(page, "Results")
    page.get_by_role("button", name="Profile").click()
    page.locator("svg.profile").first.wait_for()
    keep = page.get_by_role("button", name="Keep it in the open station")
    assert keep.is_disabled()
    page.get_by_text("open station_b.toml first: this result belongs to it").wait_for()
    open_station(page, "station_b.toml")
    go(page, "Results")
    assert keep.is_enabled()
    open_station(page, "station.toml")
    go(page, "Results")
    assert keep.is_disabled()
    results[0] = {**RESULT, "station": None}
    go(page, "Results")
    page.get_by_role("button", name="Profile").click()
    page.get_by_text("the station of this result is not in the opened folder").wait_for()
    require_accessible(page)


def test_a_profile_that_comes_late_is_dropped(page: Any) -> None:
    page.route("**/api/results*", lambda route: route.fulfill(json=[RESULT]))
    page.route("**/api/relief*", lambda route: route.fulfill(body=encode(np.zeros((160, 200), np.uint8), "PNG")))
    kept: list[Any] = []

    def answer(route: Any) -> None:
        far = route.request.post_data_json["to"][0]
        if far == 100:
            kept.append(route)
        else:
            route.fulfill(json=section_to(far))

    page.route("**/api/profile", answer)
    go(page, "Results")
    page.get_by_role("button", name="Profile").click()
    far, show = page.get_by_label("to x"), page.get_by_role("button", name="Draw", exact=True).last
    chart = page.locator("svg.profile").first
    for place in ("100", "120"):
        far.fill(place)
        show.click()
    page.locator("svg.profile[aria-label*='along 120 mm']").first.wait_for()
    kept[0].fulfill(json=section_to(100))
    page.wait_for_timeout(300)
    assert "along 120 mm" in str(chart.get_attribute("aria-label"))


def section_to(far: int) -> dict[str, Any]:
    return {"unit": "mm", "along": [0, far / 2, far], "prior": [0, 1, 0], "fused": [0, 2, 0]}


def test_an_open_log_grows_with_its_run(page: Any) -> None:
    lines = ["first line"]
    page.route("**/api/runs*", lambda route: route.fulfill(json=[{**RUN, "state": "running"}]))
    page.route("**/api/log*", lambda route: route.fulfill(json={"lines": lines}))
    go(page, "Run")
    page.get_by_text("Log", exact=True).click()
    page.locator("pre", has_text="first line").wait_for()
    lines.append("second line")
    page.locator("pre", has_text="second line").wait_for()


def test_entries_for_a_new_station_survive_a_visit_to_another_part(page: Any) -> None:
    go(page, "Images")
    page.get_by_role("button", name="views (3 images)").click()
    page.locator("#preview .warning").wait_for()
    angle = page.get_by_label("Angle of view_00.jpg")
    angle.fill("10")
    page.get_by_label("view_08.jpg is polarized").uncheck()
    assert page.get_by_label("Pixel values are").input_value() == "srgb"  # These are JPEGs.
    name, file = page.locator("#new-station [name=name]"), page.locator("#new-station [name=path]")
    name.fill("Bust")
    file.fill("bust.toml")
    go(page, "Results")
    go(page, "Images")
    assert (angle.input_value(), name.input_value(), file.input_value()) == ("10", "Bust", "bust.toml")
    assert not page.get_by_label("view_08.jpg is polarized").is_checked()
    # Another folder starts with fresh entries, and so does this folder after the other one.
    page.get_by_role("button", name="opened folder: museum").click()
    page.get_by_role("button", name="views (3 images)").click()
    page.locator("#preview .warning").wait_for()
    assert angle.input_value() == "" and file.input_value() != "bust.toml"


def test_cameras_and_surface_are_proposed_from_the_stations_own_folder(served: Served, page: Any) -> None:
    """Another object with cameras and a cloud of its own lies beside it."""
    one, other = served.folder / "objects/one", served.folder / "objects/other"
    for place in (one, other):
        place.mkdir(parents=True)
        for part in ("sparse", "dense"):
            shutil.copytree(served.folder / part, place / part)
    (one / "station.toml").write_text("[polarized]\nimages = '../../pol'\nangles_deg = [0, 30, 60, 90, 120, 150]\n")
    go(page, "Images")
    page.get_by_role("button", name="opened folder: museum").click()
    page.get_by_role("button", name="objects", exact=True).click()
    page.get_by_role("button", name="one", exact=True).click()
    page.get_by_role("button", name="Open station.toml").click()
    proposed = "Found in this folder: the cameras in objects/one/sparse, this station as station.jpg among them, the coarse surface objects/one/dense/cloud.ply."
    page.get_by_text(proposed).wait_for()
    page.locator("#plan", has_text="The station cannot run yet").wait_for()
    page.locator("[data-says=prior]", has_text="Wrong: there is no coarse surface yet").wait_for()
    surfaces = page.get_by_label("Coarse surface (prior)").locator("option").all_inner_texts()
    assert surfaces[1] == "objects/one/dense/cloud.ply (point cloud)" and len(surfaces) == 4
    page.get_by_role("button", name="Use them").press("Enter")
    page.locator("#plan", has_text="Ready").wait_for()
    assert page.evaluate("document.activeElement.id") == "plan", "the keyboard goes on from there"
    assert 'cloud = "dense/cloud.ply"' in (one / "station.toml").read_text()
    shutil.rmtree(served.folder / "objects")


def test_a_standard_deviation_goes_with_its_surface(served: Served, page: Any, station: Path) -> None:
    sigma, surface = page.get_by_label("Its standard deviation"), page.get_by_label("Coarse surface (prior)")
    sigma.fill("0.02")
    sigma.press("Tab")
    wait_for(page, lambda: 'cloud = "dense/cloud.ply"\nsigma = 0.02' in station.read_text())
    surface.select_option("")
    wait_for(page, lambda: "[prior]" not in station.read_text())

    # A shape is shown, and another surface replaces it with its standard deviation.
    file = served.folder / "station_shape.toml"
    shape = "plane = { point = [0, 0, 0], normal = [0, 0, 1] }\nsigma = 2"
    file.write_text(STATION.replace('cloud = "dense/cloud.ply"', shape))
    go(page, "Images")
    page.get_by_role("button", name="Open station_shape.toml").click()
    page.locator("#open-station", has_text="station_shape.toml").wait_for()
    page.locator("main:not([aria-busy])").wait_for()
    assert surface.input_value() == "plane:" and sigma.input_value() == "2"
    surface.select_option("cloud:dense/cloud.ply")
    wait_for(page, lambda: file.read_text() == STATION)


def test_a_name_that_is_taken_meanwhile_is_not_proposed_again(served: Served, page: Any) -> None:
    go(page, "Images")
    page.get_by_role("button", name="pol (6 images)").click()
    page.get_by_alt_text("Phase in a circle of colors").wait_for()
    file = page.locator("#new-station [name=path]")
    proposed = file.input_value()
    (served.folder / proposed).write_text(STATION)
    go(page, "Results")
    go(page, "Images")
    assert file.input_value() != proposed
    (served.folder / proposed).unlink()


def test_stations_that_were_ticked_stay_ticked(served: Served, page: Any) -> None:
    (served.folder / "station_b.toml").write_text(STATION)
    go(page, "Run")
    page.get_by_label("Run station.toml").uncheck()
    page.get_by_label("Run station_b.toml").check()
    go(page, "Results")
    go(page, "Run")
    assert (
        page.get_by_label("Run station_b.toml").is_checked() and not page.get_by_label("Run station.toml").is_checked()
    )
    # Opening another station ticks that station alone.
    page.get_by_label("Run station.toml").check()
    open_station(page, "station_b.toml")
    go(page, "Run")
    assert (
        page.get_by_label("Run station_b.toml").is_checked() and not page.get_by_label("Run station.toml").is_checked()
    )


def test_invalid_input_does_not_remove_a_number(page: Any, station: Path) -> None:
    level = page.get_by_label("White level")
    level.fill("60000")
    level.press("Tab")
    wait_for(page, lambda: "white_level = 60000" in station.read_text())
    wait_for(page, lambda: level.get_attribute("value") == "60000")
    level.select_text()
    level.press_sequentially("1e")  # The browser reports the same value as for an empty field.
    level.press("Tab")
    page.locator("#message", has_text="Expected a number; it stays 60000").wait_for()
    assert level.input_value() == "60000" and "white_level = 60000" in station.read_text()
    level.fill("")
    level.press("Tab")
    wait_for(page, lambda: "white_level" not in station.read_text())


def test_a_similar_color_that_is_found_late_is_not_painted_elsewhere(page: Any, station: Path) -> None:
    draw(page, "mask")
    page.locator("[data-tool=similar]").click()
    kept = held(page, "similar")
    page.locator("#draw-stage").click(position={"x": 300, "y": 200})
    wait_for(page, lambda: bool(kept))
    page.locator("#draw-what").select_option("labels")
    let_go(page, kept)
    wait_for(page, lambda: 'mask = "station_mask.png"' in station.read_text())
    page.locator("#tools select").wait_for()
    page.get_by_role("button", name="Save", exact=True).click()
    page.locator("#message", has_text="Nothing is painted").wait_for()
    assert "reflection" not in station.read_text()


def test_the_edge_that_is_found_late_is_saved_with_its_mask(served: Served, page: Any, station: Path) -> None:
    draw(page, "mask")
    stage = page.locator("#draw-stage")
    page.locator("[data-tool=brush]").click()
    stage.drag_to(stage, source_position={"x": 200, "y": 200}, target_position={"x": 300, "y": 260})
    kept: list[Any] = []
    page.route("**/api/cut*", lambda route: kept.append(route))
    page.get_by_role("button", name="Find the edge").click()
    wait_for(page, lambda: bool(kept))
    hurry(page, "Run")
    page.wait_for_timeout(300)
    whole = encode(np.full((160, 200), 255, np.uint8), "PNG")
    kept[0].fulfill(body=whole, content_type="image/png")
    page.locator("#runs").wait_for(state="visible")
    wait_for(page, lambda: 'mask = "station_mask.png"' in station.read_text())
    with Image.open(io.BytesIO((served.folder / "station_mask.png").read_bytes())) as saved:
        assert np.asarray(saved).min() == 255


THREE_DISTANCES = """
[photos]
folder = "views"

[[scale]]
distance = 10
a = []
b = []

[[scale]]
distance = 20
a = []
b = []

[[scale]]
distance = 30
a = []
b = []
"""


def test_marking_continues_when_another_distance_is_removed(page: Any, station: Path) -> None:
    add(page, station, THREE_DISTANCES)
    draw(page, "scale")
    page.get_by_role("group", name="distance 2").get_by_role("button", name="Mark end a").click()
    page.get_by_role("button", name="Mark end a", pressed=True).wait_for()
    page.get_by_role("group", name="distance 1").get_by_role("button", name="Remove").click()
    page.get_by_role("group", name="distance 3").wait_for(state="detached")
    page.get_by_role("group", name="distance 1").get_by_role("button", name="Mark end a", pressed=True).wait_for()
    page.locator("#draw-stage").click(position={"x": 100, "y": 100})
    wait_for(page, lambda: "view_00.jpg" in station.read_text())
    second, third = station.read_text().split("[[scale]]")[1:]
    assert "distance = 20" in second and "view_00.jpg" in second and "view_00.jpg" not in third
    # When the distance that is being marked is removed, marking ends.
    page.get_by_role("group", name="distance 1").get_by_role("button", name="Remove").click()
    page.get_by_role("group", name="distance 2").wait_for(state="detached")
    page.locator("[data-tool=move][aria-pressed=true]").wait_for()


def test_no_gaps_show_between_the_tiles_of_an_image(page: Any) -> None:
    square = io.BytesIO()
    Image.new("L", (512, 512), 200).save(square, "JPEG")
    page.route("**/api/size*", lambda route: route.fulfill(json={"width": 1536, "height": 512}))
    page.route("**/api/tile*", lambda route: route.fulfill(body=square.getvalue(), content_type="image/jpeg"))
    draw(page, "profile")

    def row() -> Any:
        box = page.locator("#draw-stage").bounding_box()
        shown = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("L"), dtype=int)
        y, left, right = (int(part) for part in (box["y"] + box["height"] / 2 - 20, box["x"], box["x"] + box["width"]))
        return shown[y, left + 10 : right - 10]

    for _ in range(4):  # at several sizes; the last one is checked below
        wait_for(page, lambda: abs(np.median(row()) - 200) <= 2)
        wait_for(page, lambda: abs(row() - 200).max() <= 2)
        page.locator("#draw-stage").press("+")
        page.wait_for_timeout(500)  # the zoom takes 0.35 s
    assert abs(row() - 200).max() <= 2


def test_no_coordinates_are_taken_if_a_line_is_wrong(page: Any, station: Path) -> None:
    add(page, station, '\n[[control]]\nname = "A"\nxyz = [1, 2, 3]\n')
    draw(page, "control")
    typed = page.get_by_label("Coordinates, a point a line: name X Y Z")
    typed.fill("A 7 8 9\nP1 1 2 3\nP2 4 5")
    page.get_by_role("button", name="Take these coordinates").click()
    page.locator("#message", has_text="P2 4 5").wait_for()
    typed.fill("P1;104,21;88")  # not 104, 21 and 88
    page.get_by_role("button", name="Take these coordinates").click()
    page.locator("#message", has_text="P1;104,21;88").wait_for()
    typed.fill("")
    page.get_by_label("only to check").check()
    wait_for(page, lambda: "check = true" in station.read_text())
    assert "P1" not in station.read_text() and "xyz = [1, 2, 3]" in station.read_text()


def test_a_missing_image_to_draw_on_is_explained(served: Served, page: Any, station: Path) -> None:
    outside = served.folder.parent / "outside"
    shutil.copytree(served.folder / "pol", outside)
    station.write_text(STATION.replace('"pol"', '"../outside"'))
    go(page, "Station")
    draw_button = page.get_by_role("banner").get_by_role("button", name="Draw", exact=True)
    draw_button.click()
    page.locator("#draw-side", has_text="lies outside the folder that Studio has opened").wait_for()
    shutil.rmtree(outside)


def test_files_with_undecodable_names_are_listed(served: Served, page: Any) -> None:
    odd = served.folder / os.fsdecode(b"B\xfcste.png")
    odd.write_bytes(b"")
    go(page, "Images")
    page.locator("#folder-list", has_text="B\\xfcste.png").wait_for()
    odd.unlink()


def test_a_mask_beside_the_images_is_taken_as_the_mask(served: Served, page: Any) -> None:
    folder = served.folder / "masked"
    shutil.copytree(served.folder / "pol", folder)
    (folder / "mask.png").write_bytes(encode(np.full((160, 200), 255, np.uint8), "PNG"))
    go(page, "Images")
    page.get_by_role("button", name="masked (7 images)").click()
    page.get_by_alt_text("Phase in a circle of colors").wait_for()
    assert not page.get_by_label("mask.png is polarized").is_checked()
    page.get_by_label("File", exact=True).fill("masked.toml")
    page.get_by_role("button", name="Create the station").click()
    page.locator("#open-station", has_text="masked.toml").wait_for()
    assert 'mask = "masked/mask.png"' in (served.folder / "masked.toml").read_text()
    (served.folder / "masked.toml").unlink()
    shutil.rmtree(folder)
