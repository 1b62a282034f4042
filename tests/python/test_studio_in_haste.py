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
    page.get_by_role("button", name="opened folder: museum").click()
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
