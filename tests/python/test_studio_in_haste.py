"""Studio's page and people who are quicker than its answers."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

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

#: What a person has made of the folder's images, cameras and cloud.
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


def test_what_is_typed_while_an_answer_is_awaited_stays(page: Any, station: Path) -> None:
    kept = held(page, "set")
    place = page.get_by_role("textbox", name="Name of the object")
    place.fill("Quick")
    level = page.get_by_label("White level")
    level.click()  # which leaves the name
    level.press_sequentially("60")
    let_go(page, kept, "set")
    page.locator("#station-text").evaluate(
        "text => new Promise(done => { const look = () => text.value.includes('Quick') ? done() : setTimeout(look, 20); look(); })"
    )
    level.press_sequentially("000")
    level.press("Tab")
    wait_for(page, lambda: "white_level = 60000" in station.read_text())
    assert 'name = "Quick"' in station.read_text()
    wait_for(page, lambda: level.get_attribute("value") == "60000")
    # What was typed in whole before the answer came is a change, too.
    kept = held(page, "set")
    place.fill("Slow")
    level.click()
    level.fill("")
    let_go(page, kept, "set")
    wait_for(page, lambda: place.get_attribute("value") == "Slow")
    level.press("Tab")
    wait_for(page, lambda: "white_level" not in station.read_text())
    assert 'name = "Slow"' in station.read_text()
    wait_for(page, lambda: not level.get_attribute("value"))
    # So does what was marked: the next key replaces it.
    kept = held(page, "set")
    level.fill("50000")
    place.select_text()  # which leaves the level
    let_go(page, kept, "set")
    wait_for(page, lambda: level.get_attribute("value") == "50000")
    page.keyboard.insert_text("Marked")
    kept = held(page, "set")
    level.select_text()  # which leaves the name
    let_go(page, kept, "set")
    wait_for(page, lambda: place.get_attribute("value") == "Marked")
    page.keyboard.insert_text("70000")
    page.keyboard.press("Tab")
    wait_for(page, lambda: "white_level = 70000" in station.read_text())
    assert 'name = "Marked"' in station.read_text()


def test_the_last_of_quick_choices_counts(served: Served, page: Any) -> None:
    from playwright.sync_api import expect

    for name in ("Images", "Station", "Draw", "Options", "Station", "Run", "Draw"):
        hurry(page, name)
    page.locator("main:not([aria-busy])").wait_for()
    assert page.evaluate("[...document.querySelectorAll('main > section')].filter(one => !one.hidden).map(one => one.id)") == ["draw"]  # fmt: skip
    assert page.evaluate("document.querySelectorAll('#draw, #draw [inert]').length") == 1
    assert page.locator("[data-tool=move]").count() == 1
    # A folder that answers late is not shown instead of the one that was chosen after it.
    go(page, "Images")
    page.get_by_role("button", name="pol (6 images)").wait_for()
    kept = held(page, "folder")
    page.get_by_role("button", name=re.compile(r"^views \(")).click()
    wait_for(page, lambda: bool(kept))
    page.get_by_role("button", name="pol (6 images)").click()
    page.get_by_alt_text("Phase in a circle of colors").wait_for()
    let_go(page, kept, "folder")
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
    """What another program writes into the station's file, and is shown in the page."""
    station.write_text(station.read_text() + text)
    go(page, "Station")


def test_two_changes_of_a_list_at_once_are_both_made(page: Any, station: Path) -> None:
    add(page, station, TWO_PATCHES)
    draw(page, "patch")
    kept = held(page, "set")
    for name in ("first", "second"):
        page.get_by_role("group", name=f"patch {name}").get_by_role("button", name="Remove").click()
    page.get_by_role("button", name="Add one by numbers").click()
    let_go(page, kept, "set")
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


def test_an_image_that_is_chosen_while_another_one_is_loading_is_drawn_on(page: Any) -> None:
    kept = held(page, "size")
    go_on = page.get_by_role("banner").get_by_role("button", name="Draw", exact=True)
    go_on.click()
    wait_for(page, lambda: bool(kept))
    # By the keyboard or a script, as what is inert takes no pointer.
    page.locator("#draw-image").evaluate("one => { one.selectedIndex = 2; one.dispatchEvent(new Event('change')); }")
    let_go(page, kept, "size")
    page.locator("main:not([aria-busy])").wait_for()
    page.wait_for_function("!document.querySelector('#draw [inert]')")


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
    page.mouse.click(box["x"] + 300, box["y"] + 200)  # on the photo that is still to be seen
    let_go(page, kept, "size")
    page.locator("#draw-stage:not([inert])").wait_for()
    page.locator("#draw-stage").click(position={"x": 100, "y": 100})
    page.get_by_text(re.compile(r"in \d photos: .*view_04.jpg")).wait_for()
    go(page, "Draw")
    page.get_by_role("button", name="Undo the last change").click()
    page.get_by_text(re.compile(r"in 0 photos")).first.wait_for()
    assert "view_04" not in station.read_text()  # there was one mark only


def test_nothing_is_painted_while_the_edge_is_looked_for(page: Any) -> None:
    draw(page, "mask")
    stage = page.locator("#draw-stage")
    page.locator("[data-tool=brush]").click()
    stage.drag_to(stage, source_position={"x": 200, "y": 200}, target_position={"x": 300, "y": 260})
    kept = held(page, "cut")
    page.get_by_role("button", name="Find the edge").click()
    wait_for(page, lambda: bool(kept))
    assert stage.evaluate("stage => stage.inert")
    let_go(page, kept, "cut")
    page.locator("#draw-stage:not([inert])").wait_for()


def test_a_tool_that_is_chosen_by_the_keyboard_keeps_it(page: Any) -> None:
    draw(page, "patch")
    page.locator("[data-tool=box]").focus()
    page.keyboard.press("Enter")
    page.locator("[data-tool=box][aria-pressed=true]").wait_for()
    assert page.evaluate("document.activeElement.dataset.tool") == "box"


def test_a_step_of_undo_that_fails_is_not_lost(page: Any, station: Path) -> None:
    place = page.get_by_role("textbox", name="Name of the object")
    place.fill("Other")
    place.press("Tab")
    wait_for(page, lambda: "Other" in station.read_text())
    page.route("**/api/text", lambda route: route.fulfill(status=400, json={"error": "no room on the disk"}))
    page.get_by_role("button", name="Undo the last change").click()
    page.locator("#message", has_text="no room on the disk").wait_for()
    page.unroute("**/api/text")
    page.get_by_role("button", name="Undo the last change").click()
    wait_for(page, lambda: "Other" not in station.read_text())
    page.locator("#redo:not([disabled])").wait_for()


def test_text_of_the_file_that_is_being_typed_stays(page: Any, station: Path) -> None:
    text = page.locator("#station-text")
    page.locator("summary", has_text="The station file").click()
    kept = held(page, "set")
    place = page.get_by_role("textbox", name="Name of the object")
    place.fill("Quick")
    place.press("Tab")
    text.press("Control+End")
    text.press_sequentially("# typed meanwhile")
    let_go(page, kept, "set")
    wait_for(page, lambda: "Quick" in station.read_text())
    page.wait_for_function("document.querySelector('#fields input').value === 'Quick'")
    assert text.input_value().endswith("# typed meanwhile") and "Quick" not in text.input_value()
    # It was typed upon a file that has changed since: that is said before it replaces the file.
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
    let_go(page, kept, "set")
    wait_for(page, lambda: "Quick" in station.read_text())
    page.locator("#open-station", has_text=other.name).wait_for()
    page.locator("#plan", has_text="Ready").wait_for()
    assert page.locator("#open-station").text_content() == other.name
    assert "Quick" not in other.read_text()


def test_a_press_that_lasts_longer_than_an_answer_is_a_press(page: Any, station: Path) -> None:
    add(page, station, TWO_PATCHES)
    draw(page, "patch")
    kept = held(page, "set")
    field = page.get_by_role("group", name="patch first").get_by_label("name")
    field.fill("mine")
    removing = page.get_by_role("group", name="patch second").get_by_role("button", name="Remove").bounding_box()
    assert removing
    page.mouse.move(removing["x"] + 5, removing["y"] + 5)
    page.mouse.down()  # which leaves the field
    let_go(page, kept, "set")
    wait_for(page, lambda: "mine" in station.read_text())
    page.wait_for_timeout(300)
    page.mouse.up()
    wait_for(page, lambda: "second" not in station.read_text())
    assert "mine" in station.read_text()


def test_angles_that_are_typed_before_the_names_are_read_stay(page: Any) -> None:
    go(page, "Images")
    kept = held(page, "angles")
    page.get_by_role("button", name="pol (6 images)").click()
    typed = page.get_by_label("Angle of pol_030.tif")
    typed.fill("33")
    typed.press("Tab")
    let_go(page, kept, "angles")
    page.get_by_alt_text("Phase in a circle of colors").wait_for()
    assert page.get_by_label("Angle of pol_060.tif").input_value() == "60"
    assert typed.input_value() == "33"


def test_a_check_that_fails_is_said(page: Any, station: Path) -> None:
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
    let_go(page, kept, "preview")
    page.wait_for_timeout(300)
    assert page.locator("#preview .warning").count() == 1


def test_the_surface_upon_the_image_is_that_of_the_file(page: Any, station: Path) -> None:
    show = page.get_by_role("button", name="Show the coarse surface upon the image")
    show.click()
    page.locator("#overlay-note", has_text="Yellow is near").wait_for()
    cameras = page.get_by_label("Cameras (COLMAP model)")
    cameras.select_option("")
    page.locator("#overlay-stage").wait_for(state="hidden")
    cameras.select_option("sparse")
    page.locator("#plan", has_text="Ready").wait_for()
    kept = held(page, "overlay")
    show.click()
    wait_for(page, lambda: bool(kept))
    cameras.select_option("")
    page.locator("#plan", has_text="cannot run yet").wait_for()
    let_go(page, kept, "overlay")
    page.wait_for_timeout(300)
    assert not page.locator("#overlay-note").text_content() and page.locator("#overlay-stage").is_hidden()


def test_what_is_said_of_another_mark_is_dropped(page: Any, station: Path) -> None:
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


#: A run as the page is told of it.
RUN = {
    "number": 1, "title": "museum", "state": "waiting", "fraction": 0, "step": "", "message": "", "seconds_left": None, "steps": {},
    "error": "", "work": "station_work", "report": None, "asked": {"name": "run", "body": {}},
}  # fmt: skip


def test_a_button_of_a_run_that_begins_meanwhile_keeps_the_keyboard(page: Any) -> None:
    run = dict(RUN)
    page.route("**/api/runs*", lambda route: route.fulfill(json=[run]))
    go(page, "Run")
    page.get_by_role("button", name="Cancel").focus()
    run["state"] = "running"
    page.locator("p[data-state]", has_text="starting").wait_for()
    assert page.evaluate("document.activeElement.textContent") == "Cancel"


def test_results_that_cannot_be_read_can_be_scrolled_to_by_the_keyboard(page: Any) -> None:
    broken = [
        {"path": f"work_{k}", "problem": f"manifest.json: no results of a run ({'broken ' * 20})"} for k in (1, 2)
    ]
    page.route("**/api/results*", lambda route: route.fulfill(json=broken))
    page.set_viewport_size({"width": 390, "height": 844})
    go(page, "Results")
    require_accessible(page)
