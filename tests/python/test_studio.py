"""Studio: who may talk to it, what it writes, and the whole way from a folder to the report in a real browser."""

from __future__ import annotations

import asyncio
import importlib
import io
import json
import os
import re
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar
from urllib.parse import urlencode, urlsplit

import numpy as np
import pytest

from conftest import EXAMPLE
from malus import Camera, DataError, InputError, Station, _core
from malus.options import Options
from malus.photogrammetry.model import SparseModel
from malus.pictures import encode
from studio_browser import (
    PATIENCE_MS,
    RUN_MS,
    Served,
    brought,
    chromium,
    draw,
    go,
    needs_browser,
    needs_studio,
    opened,
    paused,
    pictured,
    require_accessible,
    studio,
    wait_for,
)
from test_raw import ANGLES, scene, write_dng

marks = pytest.importorskip("malus.studio.marks")
pytestmark = needs_studio


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory, small_station_source: Path) -> Iterator[Served]:
    folder = brought(small_station_source, tmp_path_factory.mktemp("studio") / "museum")
    (folder.parent / "secret.png").write_bytes((EXAMPLE / "pol" / "pol_000.png").read_bytes())
    (folder / "way_out").symlink_to(folder.parent)
    with studio(folder) as running:
        yield running


# ---- who may talk to it ----


def test_nothing_is_served_without_the_key(served: Served) -> None:
    for address in ("/", "/api/folder?path=", "/static/studio.js", "/?token=wrong"):
        assert served.ask("GET", address, {})[0] == 403
    assert served.ask("GET", "/api/folder?path=", {"Cookie": served.cookie()})[0] == 200


def test_other_names_of_this_computer_are_refused(served: Served) -> None:
    port = served.host.split(":")[1]
    for host in (f"evil.example:{port}", "127.0.0.1", f"127.0.0.1.evil.example:{port}"):
        assert served.ask("GET", "/", {"Host": host, "Cookie": served.cookie()})[0] == 421


def test_a_body_that_is_too_large_is_refused_for_its_size(served: Served) -> None:
    status, told = served.tell("mask?path=a.toml&image=pol_000.png", bytes(64_000_001), "PUT")
    assert status == 413 and "more than 64 MB" in told


def test_changes_need_the_own_page(served: Served) -> None:
    cookie = served.cookie()
    token = served.page_token(cookie)
    own = {"Cookie": cookie, "Origin": f"http://{served.host}", "X-Malus-Page": token}
    body = '{"path": "other.toml", "images": [], "angles_deg": []}'
    for wrong in ({"Origin": "http://evil.example"}, {"Origin": "null"}, {"X-Malus-Page": "x"}, {"Cookie": "x=y"}):
        assert served.ask("POST", "/api/create", {**own, **wrong}, body)[0] == 403
        assert not (served.folder / "other.toml").exists()
    assert served.ask("POST", "/api/create", own, body)[0] == 200
    (served.folder / "other.toml").unlink()


@pytest.mark.parametrize(
    "path", ["../secret.png", "/etc/passwd", "way_out/secret.png", "pol/../../secret.png", "a%00b"]
)
def test_nothing_outside_the_folder_is_shown(served: Served, path: str) -> None:
    status, _, text = served.ask("GET", f"/api/thumbnail?path={path}", {"Cookie": served.cookie()})
    assert status == 400
    assert "outside the folder" in text or "no file name has" in text


def test_pages_may_load_nothing_from_elsewhere(served: Served) -> None:
    headers = served.ask("GET", "/", {"Cookie": served.cookie()})[1]
    policy = headers["content-security-policy"]
    assert headers["cross-origin-resource-policy"] == "same-origin"
    assert "default-src 'self'" in policy and "frame-ancestors 'self'" in policy
    status, headers, _ = served.ask("GET", "/report/guess/index.html", {})
    assert status == 404 and f"img-src {served.host} localhost:" in headers["content-security-policy"]


def test_only_this_computer_is_listened_to(served: Served) -> None:
    assert urlsplit(served.entrance).hostname == "127.0.0.1"
    port = int(served.host.split(":")[1])
    listening = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    places = {
        fields[1].split(":")[0]
        for fields in listening
        if int(fields[1].split(":")[1], 16) == port and fields[3] == "0A"
    }
    assert places == {"0100007F"}


@pytest.fixture
def odd_folder(tmp_path: Path) -> Iterator[Any]:
    """Studio for a folder in which a stranger's archive was unpacked, with a secret beside it."""
    from malus.studio.app import Studio

    (tmp_path / "secret").mkdir()
    (tmp_path / "secret/index.html").write_text("secret")
    folder = tmp_path / "museum"
    (folder / "work/report").mkdir(parents=True)
    (folder / "work/report/index.html").write_text("report")
    (folder / "work/report/out").symlink_to(tmp_path / "secret")
    (folder / "linked").mkdir()
    (folder / "linked/report").symlink_to(tmp_path / "secret")
    (folder / "circle").symlink_to("circle")
    (folder / "way_out").symlink_to(tmp_path)
    for name in ("pipe.toml", "pipe.ply", "pipe.tif"):
        os.mkfifo(folder / name)
    studio = Studio(folder, 1)
    yield studio
    studio.runs.close()


def test_circles_and_pipes_in_the_folder_stop_nothing(odd_folder: Any) -> None:
    folders = pytest.importorskip("malus.studio.folders")
    assert [entry["name"] for entry in folders.listing(odd_folder.root, "")["folders"]] == ["linked", "work"]
    assert folders.candidates(odd_folder.root)["stations"] == []


def test_a_pipe_is_neither_written_to_nor_waited_for(odd_folder: Any) -> None:
    """A thread waited for it, for ever, and Studio could not be ended."""
    masks, document = (importlib.import_module(f"malus.studio.{name}") for name in ("masks", "document"))
    folder = odd_folder.root.folder
    with pytest.raises(OSError, match="not a regular file"):
        document.StationDocument(folder / "pipe.toml", "").write(None)
    with pytest.raises(OSError, match="not a regular file"):
        masks.write(folder / "pipe.tif", np.zeros((4, 4), np.uint8), may_replace=False)


def test_a_result_of_another_version_does_not_hide_the_others(odd_folder: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    results = importlib.import_module("malus.studio.results")

    monkeypatch.setattr(results, "Workspace", lambda folder: SimpleNamespace(folder=folder, quality={"name": "old"}))
    assert "cannot be shown" in results.summary(odd_folder.root, odd_folder.root.folder / "work")["problem"]


def test_reports_show_nothing_outside_the_folder(odd_folder: Any) -> None:
    from starlette.requests import Request

    def asked(work: str, path: str) -> int:
        key = odd_folder._report_address(odd_folder.root.folder / work / "report").split("/")[2]
        scope = {"type": "http", "method": "GET", "headers": [], "path_params": {"key": key, "path": path}}
        return int(asyncio.run(odd_folder._report(Request(scope))).status_code)

    assert asked("work", "index.html") == 200
    for work, path in (
        ("work", "out/index.html"),
        ("work", "../../pipe.toml"),
        ("work", "a\0b"),
        ("work", "x" * 300),
        ("linked", "index.html"),
    ):
        assert asked(work, path) == 404, (work, path)


def test_what_nobody_has_thought_of_is_said_on_the_page(capfd: pytest.CaptureFixture[str]) -> None:
    from malus.studio.app import _answer

    def fail() -> None:
        raise IndexError("nobody thought of this")

    response = asyncio.run(_answer(fail))
    assert response.status_code == 500 and "please report it: IndexError" in json.loads(response.body)["error"]
    assert capfd.readouterr().err == ""


def test_what_json_cannot_say_can_be_opened_and_mended(tmp_path: Path) -> None:
    from malus.studio.app import Studio, _answer

    (tmp_path / "dated.toml").write_text(
        "[object]\ndate = 1890-05-01\n[polarized]\nwhite_level = inf\nangles_deg = [nan, 45, 90]\n"
    )
    studio = Studio(tmp_path, 1)
    response = asyncio.run(_answer(lambda: studio._station({"path": "dated.toml"})))
    said = json.loads(response.body)
    assert response.status_code == 200 and "date = 1890-05-01" in said["text"]
    assert said["values"]["object"]["date"] == "1890-05-01"
    assert said["values"]["polarized"] == {"white_level": None, "angles_deg": [None, 45, 90]}
    studio.runs.close()


def test_names_that_are_no_text_and_folders_that_are_locked_hide_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from malus.studio.app import Studio, _answer

    for name in (b"B\xfcste.png", b"B\xfcste_work"):
        (tmp_path / os.fsdecode(name)).mkdir()
    for name in ("found", "locked"):
        (tmp_path / name).mkdir()
    stat = Path.stat

    def locked(path: Path, **kept: Any) -> os.stat_result:
        if path.parent.name == "locked":
            raise PermissionError(13, "Permission denied", str(path))
        return stat(path, **kept)

    monkeypatch.setattr(Path, "stat", locked)
    (tmp_path / os.fsdecode(b"B\xfcste_work") / "manifest.json").write_text('{"format": 2, "steps": {}}')
    studio = Studio(tmp_path, 1)
    folders = importlib.import_module("malus.studio.folders")
    for asked in (lambda: folders.listing(studio.root, ""), lambda: studio._results({})):
        response = asyncio.run(_answer(asked))
        assert response.status_code == 200, response.body
    said = folders.listing(studio.root, "")
    assert [entry["name"] for entry in said["folders"]] == ["found", "locked"]
    assert said["hidden"] == ["B\\xfcste.png", "B\\xfcste_work"]
    studio.runs.close()


def test_results_lie_as_deep_as_their_stations(served: Served) -> None:
    deep = served.folder / "2026" / "castle" / "hall"
    (deep / "station_work").mkdir(parents=True)
    (deep / "station.toml").write_text('[polarized]\nimages = "pol"\n')
    (deep / "station_work" / "manifest.json").write_text('{"format": 2, "steps": {}}')
    assert "2026/castle/hall/station.toml" in served.asked("candidates")["stations"]
    assert "2026/castle/hall/station_work" in [result["path"] for result in served.asked("results")]
    shutil.rmtree(served.folder / "2026")


def test_names_with_digits_of_other_kinds_are_listed(tmp_path: Path) -> None:
    """① and ² count as digits, but not as numbers."""
    from malus.studio.access import Root

    folders = importlib.import_module("malus.studio.folders")
    for name in ("②001.png", "①010.png", "①9.png", "5².png"):
        (tmp_path / name).write_bytes((EXAMPLE / "pol" / "pol_000.png").read_bytes())
    listed = folders.listing(Root(tmp_path), "")["images"]
    assert [image["name"] for image in listed] == ["5².png", "①9.png", "①010.png", "②001.png"]


def test_a_manifest_of_something_else_is_no_result(tmp_path: Path) -> None:
    from malus.studio.app import Studio

    iiif = {"@context": "http://iiif.io/api/presentation/3/context.json", "type": "Manifest", "items": []}
    for name, text in (("", json.dumps(iiif)), ("page", "[1]"), ("damaged_work", '{"format": 2, "st'), ("tiles", "{}")):
        (tmp_path / name).mkdir(exist_ok=True)
        (tmp_path / name / "manifest.json").write_text(text)
    (tmp_path / "page/station.toml").write_text('[polarized]\nimages = "pol"\n')
    squares = tmp_path / "tiles/picture/full/max/0"
    squares.mkdir(parents=True)
    (squares / "default.jpg").write_bytes(b"")
    (tmp_path / "tiles/picture/info.json").write_text("{}")
    studio = Studio(tmp_path, 1)
    studio.runs.close()
    folders = importlib.import_module("malus.studio.folders")
    assert [result["path"] for result in studio._results({})] == ["damaged_work"]
    assert {entry["name"]: entry["is_work"] for entry in folders.listing(studio.root, "")["folders"]} == {
        "damaged_work": True, "page": False, "tiles": False
    }  # fmt: skip
    found = folders.candidates(studio.root)
    assert found["stations"] == ["page/station.toml"] and found["images"] == []
    with pytest.raises(InputError, match="tiles: holds other files"):
        studio._run({"path": "page/station.toml", "work": "tiles", "fusion": "grid"})


def test_a_folder_with_too_many_files_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from malus.studio.app import Studio

    for name, text in (("a/1.png", ""), ("a/2.png", ""), ("b/station.toml", "[polarized]\n")):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    studio = Studio(tmp_path, 1)
    studio.runs.close()
    folders = importlib.import_module("malus.studio.folders")
    found = folders.candidates(studio.root)
    assert found["stations"] == ["b/station.toml"] and found["note"] is None
    monkeypatch.setattr(folders, "_SEARCHED", 4)
    found = folders.candidates(studio.root)
    assert found["stations"] == [] and "holds more than 4 files" in found["note"]


def test_of_two_pages_that_create_a_station_at_once_one_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from malus.studio.app import Studio
    from malus.studio.document import StationDocument

    studio = Studio(tmp_path, 1)
    studio.runs.close()
    require, meeting = StationDocument.require, threading.Barrier(2)

    def require_both(document: StationDocument, expected: str | None) -> None:
        """Looks whether the file is there, and waits for the other page to have looked, too."""
        require(document, expected)
        with suppress(threading.BrokenBarrierError):
            meeting.wait(timeout=3)

    monkeypatch.setattr(StationDocument, "require", require_both)

    def create(name: str) -> str:
        try:
            return str(studio._create({"path": "a.toml", "name": name, "images": [], "angles_deg": []})["text"])
        except InputError as error:
            return str(error)

    with ThreadPoolExecutor(2) as pages:
        first, second = pages.map(create, ("one", "two"))
    written = (tmp_path / "a.toml").read_text()
    assert written in (first, second)
    assert "exists already" in (second if written == first else first)


def test_two_runs_do_not_share_a_folder(tmp_path: Path) -> None:
    from malus.studio.app import Studio

    for name in ("first", "second"):
        (tmp_path / f"{name}.toml").write_text('[polarized]\nimages = "pol"\n')
    studio = Studio(tmp_path, 1)
    studio.runs.close()  # what is added waits
    asked = {"path": "first.toml", "work": "work", "fusion": "refined"}
    number = studio._run(asked)["number"]
    assert studio._run(dict(asked))["number"] == number  # the button was pressed twice
    for other in ({**asked, "fusion": "grid"}, {**asked, "path": "second.toml"}):
        with pytest.raises(InputError, match=r"work: first.toml → work has not ended"):
            studio._run(other)
    assert len(studio.runs.all()) == 1


def test_odd_lines_of_a_run_do_not_end_the_queue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs = pytest.importorskip("malus.studio.runs")
    program = tmp_path / "python"
    program.write_text("#!/bin/sh\nprintf '\\377\\n5\\nnull\\n%0200000d\\n' 0 | tr 0 '['\nprintf '\\377\\n' >&2\n")
    program.chmod(0o755)
    monkeypatch.setattr(runs.sys, "executable", str(program))
    queue = runs.Runs()
    for name in ("first", "second"):
        run = queue.add_station(tmp_path / "station.toml", tmp_path / name, "grid", name, {})
        end = time.monotonic() + 60
        while run.state in ("waiting", "running") and time.monotonic() < end:
            time.sleep(0.01)
        assert run.state == "done"
    queue.close()


def test_a_run_that_was_canceled_too_late_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs = pytest.importorskip("malus.studio.runs")
    program = tmp_path / "python"
    program.write_text("#!/bin/sh\ntrap 'exit 0' INT\necho ready\nwhile :; do sleep 0.1; done\n")
    program.chmod(0o755)
    monkeypatch.setattr(runs.sys, "executable", str(program))
    queue = runs.Runs()
    run = queue.add_station(tmp_path / "station.toml", tmp_path / "work", "grid", "work", {})
    wait_until(lambda: run.log == ["ready"])
    queue.cancel(run.number)
    wait_until(lambda: run.state == "done")
    queue.close()


def wait_until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + 60
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.parametrize(
    ("message", "field"),
    [
        (
            'the object is 9 m wide, 90 m from the camera: that is unlikely: is unit = "mm" meant instead of "m"?',
            "unit",
        ),
        ('[station] unit = "parsec", expected um, mm, cm, m, in or ft', "unit"),
        ("[[scale]] 1: distance = -3, expected more than 0", "scale"),
        ('[prior] cloud = "a.ply": no such file', "prior"),
    ],
)
def test_messages_stand_beside_the_field_that_they_concern(message: str, field: str) -> None:
    from malus.studio.checks import field_of

    assert field_of(message) == field
    assert f"'{field}', '" in resources.files("malus").joinpath("studio/static/station.js").read_text()


# ---- what it writes ----


def test_comments_stay_and_only_what_changed_changes(tmp_path: Path) -> None:
    from malus.studio.document import StationDocument

    path = tmp_path / "station.toml"
    text = '# The bust.\n[station]\nname = "bust"  # of Nero\n\n[polarized]\nimages = [  # in order\n  "a.png",\n  "b.png",\n]\nangles_deg = [0, 45]\n\n[[patch]]\n# the plinth\nname = "1"\nbox = [1, 2, 3, 4]\n'  # fmt: skip
    path.write_text(text)
    document = StationDocument.read(path)
    document.set("station", "name", "head")
    document.set("polarized", "images", ["a.png", "b.png"])
    document.set("polarized", "mask", "mask.png")
    document.set_list("patch", [{"name": "1", "box": [1, 2, 3, 9]}, {"name": "2", "box": [5, 5, 6, 6]}])
    document.write(document.digest)
    written = path.read_text()
    for kept in ("# The bust.", "# of Nero", "# in order", "# the plinth"):
        assert kept in written
    assert written.startswith(
        '# The bust.\n[station]\nname = "head"  # of Nero\n\n[polarized]\nimages = [  # in order\n  "a.png",\n'
    )
    values = StationDocument.read(path).values
    assert values["polarized"]["mask"] == "mask.png"
    assert values["patch"] == [{"name": "1", "box": [1, 2, 3, 9]}, {"name": "2", "box": [5, 5, 6, 6]}]


def test_a_new_value_does_not_part_the_next_table_from_its_comment(tmp_path: Path) -> None:
    from malus.studio.document import StationDocument

    text = '[polarized]\nimages = ["a.png"]\n# as in the notebook\n\n# The cameras.\n[camera]\nimage = "a.png"\n'
    document = StationDocument(tmp_path / "station.toml", text)
    document.set("polarized", "mask", "mask.png")
    assert document.text == text.replace("notebook\n", 'notebook\nmask = "mask.png"\n')


@pytest.mark.parametrize(
    ("text", "change", "expected"),
    [
        ('[object]\nmaker = "x"\n\n# Glass.\n[optics]\n', ("object", "maker", None), "# Glass.\n[optics]\n"),
        ("[[patch]]\nname = 'a'\n\n# Cuts.\n[[profile]]\n", ("patch", []), "# Cuts.\n[[profile]]\n"),
        (
            "[[patch]]\nname = 'a'\n\n[[patch]]\nname = 'b'\n\n# Cuts.\n[[profile]]\n",
            ("patch", [{"name": "a"}]),
            "[[patch]]\nname = 'a'\n\n# Cuts.\n[[profile]]\n",
        ),
        (
            "[[patch]]\nname = 'a'\n\n# Cuts.\n[[profile]]\n",
            ("patch", [{"name": "a"}, {"name": "b"}]),
            "[[patch]]\nname = 'a'\n\n[[patch]]\nname = \"b\"\n\n# Cuts.\n[[profile]]\n",
        ),
        (
            "[photos]\nfolder = 'a'\n\n# A phone.\n[photos.camera]\nmodel = 'x'\n",
            ("photos", "masks", "m"),
            "[photos]\nfolder = 'a'\nmasks = \"m\"\n\n# A phone.\n[photos.camera]\nmodel = 'x'\n",
        ),
        (
            "[polarized]\nimages = ['a']\n# The lens.\n[camera]\nimage = 'a'\n",
            ("polarized", "mask", "m"),
            "[polarized]\nimages = ['a']\nmask = \"m\"\n# The lens.\n[camera]\nimage = 'a'\n",
        ),
    ],
    ids=["last key", "all patches", "last patch", "new patch", "inner table", "no blank line"],
)
def test_the_comment_on_the_next_table_stays_before_it(
    tmp_path: Path, text: str, change: tuple[Any, ...], expected: str
) -> None:
    from malus.studio.document import StationDocument

    document = StationDocument(tmp_path / "station.toml", text)
    (document.set if len(change) == 3 else document.set_list)(*change)
    assert document.text == expected


#: Parts of a station file: three patches with comments of their own and, between two blank lines, of none of them.
_HEAD = '[station]\nname = "x"\n\n# ---- patches ----\n\n'
_PATCHES = (
    '# the plinth\n[[patch]]\nname = "a"  # left\nbox = [1, 2, 3, 4]\n# below a\n',
    "# the foot\n[[patch]]\n# within b\nbox = [1, 2, 3, 5]\n",
    '# the head\n[[patch]]\nname = "c"\nbox = [1, 2, 3, 6]\n# below c\n',
)
_BETWEEN = ("\n", "\n# ---- of 2024 ----\n\n")
_BACK = '\n# Cuts.\n[[profile]]\nname = "p"\n'
_WITH_COMMENTS = _HEAD + _PATCHES[0] + _BETWEEN[0] + _PATCHES[1] + _BETWEEN[1] + _PATCHES[2] + _BACK


@pytest.mark.parametrize(
    ("removed", "expected"),
    [
        ({0}, _HEAD + _PATCHES[1] + _BETWEEN[1] + _PATCHES[2] + _BACK),
        ({1}, _HEAD + _PATCHES[0] + _BETWEEN[1] + _PATCHES[2] + _BACK),
        ({2}, _HEAD + _PATCHES[0] + _BETWEEN[0] + _PATCHES[1] + _BETWEEN[1] + _BACK[1:]),
        ({0, 1}, _HEAD + _BETWEEN[1][1:] + _PATCHES[2] + _BACK),
        ({0, 1, 2}, _HEAD + _BETWEEN[1][1:] + _BACK[1:]),
        (set(), _WITH_COMMENTS),
    ],
    ids=["first", "middle", "last", "first two", "all", "none"],
)
@pytest.mark.parametrize("end", ["\n", "\r\n"], ids=["Unix", "Windows"])
def test_a_removed_table_takes_its_comments_along_and_no_others(
    tmp_path: Path, removed: set[int], expected: str, end: str
) -> None:
    """The values of the tables behind it moved up, and their comments did not."""
    from malus.studio.document import StationDocument

    document = StationDocument(tmp_path / "station.toml", _WITH_COMMENTS.replace("\n", end))
    patches = document.values["patch"]
    document.set_list("patch", [patch for at, patch in enumerate(patches) if at not in removed])
    assert document.text == expected.replace("\n", end)


def test_a_comment_without_a_blank_line_is_of_the_next_table(tmp_path: Path) -> None:
    from malus.studio.document import StationDocument

    parts = ("[station]\n# the plinth\n[[patch]]\nname = 'a'\n", "# the foot\n[[patch]]\nname = 'b'\n", "# the end")
    document = StationDocument(tmp_path / "station.toml", "".join(parts))
    document.set_list("patch", [{"name": "b"}])
    assert document.text == "[station]\n" + parts[1] + parts[2], "nothing follows of which the last comment could be"
    document.set_list("patch", [{"name": "b"}, {"name": "c"}])
    assert document.text == "[station]\n" + parts[1] + parts[2] + '\n\n[[patch]]\nname = "c"\n'


@pytest.mark.parametrize(
    ("changed", "comments"),
    [
        ([{"name": "z", "box": [1, 2, 3, 4]}, {"box": [1, 2, 3, 5]}], {"z": "the plinth", None: "the foot"}),
        ([{"name": "a", "box": [0, 0, 9, 9]}, {"box": [0, 0, 8, 8]}], {"a": "the plinth", None: "the foot"}),
        ([{"box": [1, 2, 3, 5]}, {"name": "c", "box": [0, 0, 7, 7]}], {None: "the foot", "c": "the head"}),
        (
            [{"name": "c", "box": [1, 2, 3, 6]}, {"name": "a", "box": [1, 2, 3, 4]}],
            {"c": "the head", "a": "the plinth"},
        ),
    ],
    ids=["new name", "new values", "removed and changed", "another order"],
)
def test_a_changed_table_keeps_its_comments(
    tmp_path: Path, changed: list[dict[str, Any]], comments: dict[str | None, str]
) -> None:
    from malus.studio.document import StationDocument

    document = StationDocument(tmp_path / "station.toml", _WITH_COMMENTS)
    document.set_list("patch", changed)
    assert document.values["patch"] == changed
    above = re.findall(r"# (.+)\n\[\[patch\]\]", document.text)
    assert dict(zip([patch.get("name") for patch in changed], above, strict=True)) == comments
    assert "# Cuts.\n[[profile]]" in document.text


@pytest.mark.parametrize(
    ("text", "change", "old", "new"),
    [
        ("[photos]\nfolder = 'a'\n\n[optics]\n\n[photos.camera]\nx = 1\n", ("photos", "folder", "b"), "'a'", '"b"'),
        ("[photos.camera]\nx = 1\n\n[optics]\n\n[photos]\nfolder = 'a'\n", ("photos", "folder", "b"), "'a'", '"b"'),
        ("station.name = 'a'\nstation.unit = 'mm'\n", ("station", "name", "b"), "'a'", '"b"'),
        ("station.name = 'a'\n", ("station", "unit", "mm"), "'a'\n", "'a'\nstation.unit = \"mm\"\n"),
        ("photos.camera.x = 1\n[[photos.y]]\n", ("photos", "folder", "b"), "1\n", '1\nphotos.folder = "b"\n'),
        ("station = {name = 'a'}\n", ("station", "name", "b"), "'a'", '"b"'),
    ],
    ids=["apart", "apart before", "dotted", "new dotted", "dotted and apart", "inline"],
)
def test_tables_in_parts_and_dotted_keys_can_be_changed(
    tmp_path: Path, text: str, change: tuple[str, str, str], old: str, new: str
) -> None:
    from malus.studio.document import StationDocument

    document = StationDocument(tmp_path / "station.toml", text)
    document.set(*change)
    assert document.text == text.replace(old, new)


def test_what_cannot_be_changed_is_told(tmp_path: Path) -> None:
    from malus import InputError
    from malus.studio.document import StationDocument

    document = StationDocument(tmp_path / "station.toml", "[[photos.l]]\n[optics]\n[photos.q]\n[[photos.l.m]]\n")
    with pytest.raises(InputError, match=r"Studio cannot change photos as it is written there, expected \[photos\]"):
        document.set("photos", "folder", "b")


def test_comments_do_not_move_where_other_tables_stand_between_those_of_a_list(tmp_path: Path) -> None:
    """tomlkit gathered the patches, and the comment on the cloud then stood before the second patch."""
    from malus import InputError
    from malus.studio.document import StationDocument

    text = "[[patch]]\nname = 'a'\n\n# COMMENT\n[prior]\ncloud = 'c.ply'\n\n[[patch]]\nname = 'b'\n"
    document = StationDocument(tmp_path / "station.toml", text)
    for change in (lambda: document.set("station", "name", "x"), lambda: document.set_list("patch", [{"name": "a"}])):
        with pytest.raises(
            InputError, match=r"Studio cannot change .* expected those of each list, such as \[\[patch\]\]"
        ):
            change()
    document.write(None)
    assert document.path.read_text() == text
    # What changes nothing moves nothing.
    document.set("prior", "cloud", "c.ply")
    document.set("prior", "sigma", None)
    document.set("optics", "index", None)
    document.set_list("patch", [{"name": "a"}, {"name": "b"}])
    assert document.text == text


@pytest.mark.parametrize(
    "value", ["1", '"Vase #3"', "'Vase \\#'", '"""\n"#\\""""""', "'''\n'#'''''", r'"\"#"', """{ "#" = "'", b = 1 }"""]
)
def test_without_comments_tables_of_a_list_are_gathered(tmp_path: Path, value: str) -> None:
    """A # in a string was taken for a comment."""
    from malus import InputError
    from malus.studio.document import StationDocument

    text = f"note = {value}\n[[patch]]\nname = 'a'\n[prior]\ncloud = 'c.ply'\n[[patch]]\nname = 'b'\n"
    plain = StationDocument(tmp_path / "plain.toml", text)
    plain.set_list("patch", [{"name": "a"}])
    assert plain.values["patch"] == [{"name": "a"}]
    assert plain.values["prior"] == {"cloud": "c.ply"}
    commented = StationDocument(tmp_path / "commented.toml", text.replace("\n[[patch]]", "  # it's 1\n[[patch]]", 1))
    with pytest.raises(InputError, match="without moving comments"):
        commented.set_list("patch", [{"name": "a"}])


def test_a_file_that_changed_meanwhile_is_not_overwritten(tmp_path: Path) -> None:
    from malus import InputError
    from malus.studio.document import StationDocument

    path = tmp_path / "station.toml"
    path.write_text("[station]\n")
    document = StationDocument.read(path)
    path.write_text("[station]\n# mine\n")
    document.set("station", "name", "x")
    with pytest.raises(InputError, match="changed by another program"):
        document.write(document.digest)
    assert path.read_text() == "[station]\n# mine\n"
    with pytest.raises(InputError, match="exists already"):
        document.write(None)


def test_files_with_line_ends_of_windows_can_be_changed(tmp_path: Path) -> None:
    from malus.studio.document import StationDocument

    path = tmp_path / "station.toml"
    path.write_bytes(b"[station]\r\n# mine\r\nname = 'a'\r\n")
    document = StationDocument.read(path)
    document.set("station", "name", "b")
    document.write(document.digest)
    assert b"# mine\r\n" in path.read_bytes() and document.values["station"]["name"] == "b"


@pytest.fixture
def painted(served: Served) -> Iterator[Any]:
    """A station file of one test, and a way to save a mask of one value for it as a page that knows `painted` of its mask does."""
    names = [f"pol/pol_{angle:03}.tif" for angle in (0, 60, 120)]
    status, station = served.tell("create", {"path": "drawn.toml", "images": names, "angles_deg": [0, 60, 120]})
    assert status == 200

    def save(digest: str, value: int, painted: str = "") -> tuple[int, Any]:
        mask = np.zeros((160, 200), np.uint8)
        mask[20:40, 30:60] = value
        address = urlencode({"path": "drawn.toml", "kind": "mask", "digest": digest, "painted": painted})
        return served.tell(f"mask?{address}", encode(mask, "PNG"), "PUT")

    yield station, save
    for path in served.folder.glob("drawn*"):
        path.unlink()


def test_a_mask_is_not_written_for_a_station_that_changed_meanwhile(served: Served, painted: Any) -> None:
    station, save = painted
    status, station = save(station["digest"], 255)
    before = (served.folder / "drawn_mask.png").read_bytes()
    known = station["painted"]["mask"]["digest"]
    with (served.folder / "drawn.toml").open("a") as file:
        file.write("# mine\n")
    status, said = save(station["digest"], 0, known)
    assert status == 409 and "drawn.toml: was changed by another program" in said["error"]
    assert (served.folder / "drawn_mask.png").read_bytes() == before
    # After it was read again, what was drawn is saved, and what the other wrote stays.
    digest = served.asked("station?path=drawn.toml")["digest"]
    assert save(digest, 0, known)[0] == 200
    assert (served.folder / "drawn_mask.png").read_bytes() != before
    assert "# mine" in (served.folder / "drawn.toml").read_text()


def test_the_mask_of_another_page_is_not_overwritten(served: Served, painted: Any) -> None:
    station, save = painted
    station = save(station["digest"], 255)[1]
    of_other = (served.folder / "drawn_mask.png").read_bytes()
    status, said = save(station["digest"], 0)  # a page that was opened before there was a mask
    assert status == 409 and "drawn_mask.png: was changed by another program or page" in said["error"]
    assert (served.folder / "drawn_mask.png").read_bytes() == of_other


def test_a_mask_that_no_station_names_is_not_overwritten(served: Served, painted: Any) -> None:
    station, save = painted
    (served.folder / "drawn_mask.png").write_bytes(b"somebody's")
    station = save(station["digest"], 255)[1]
    assert station["values"]["polarized"]["mask"] == "drawn_mask_2.png"
    assert (served.folder / "drawn_mask.png").read_bytes() == b"somebody's"


def test_the_mask_of_a_station_with_a_mistake_is_shown_and_saved(served: Served, painted: Any) -> None:
    station, save = painted
    station = save(station["digest"], 255)[1]
    known = station["painted"]["mask"]
    wrong = station["text"] + '\n[[control]]\nname = "A"\nxyz = [1, 2, 3]\n'
    status, station = served.tell("text", {"path": "drawn.toml", "digest": station["digest"], "text": wrong})
    assert status == 200 and station["error"] and station["painted"]["mask"] == known
    assert save(station["digest"], 0, known["digest"])[0] == 200


# ---- what it answers ----


def test_raw_files_become_a_station(served: Served) -> None:
    pytest.importorskip("rawpy")
    folder = served.folder / "raw"
    folder.mkdir()
    for angle in ANGLES:
        write_dng(folder / f"IMG_{7300 + angle}.dng", scene(angle))
    names = [f"raw/IMG_{7300 + angle}.dng" for angle in ANGLES]
    listed = json.loads(served.ask("GET", "/api/folder?path=raw", {"Cookie": served.cookie()})[2])
    assert [image["path"] for image in listed["images"]] == names
    status, headers, _ = served.ask("GET", f"/api/thumbnail?path={names[0]}", {"Cookie": served.cookie()})
    assert (status, headers["content-type"]) == (200, "image/jpeg")
    status, said = served.tell("angles", {"folder": "raw", "source": "names", "images": names})
    assert status == 400 and "IMG_7300.dng" in said["error"]  # a file's number is no angle
    status, maps = served.tell("preview", {"images": names, "angles_deg": ANGLES, "response": "linear"})
    assert status == 200 and maps["degree_median"] == pytest.approx(0.2, abs=0.01)
    status, station = served.tell("create", {"path": "raw/station.toml", "images": names, "angles_deg": list(ANGLES)})
    assert (status, station["error"], station["images"]) == (200, None, names)
    checked = json.loads(served.ask("GET", "/api/check?path=raw/station.toml", {"Cookie": served.cookie()})[2])
    (line,) = checked["lines"]
    assert (line["severity"], line["field"]) == ("error", "prior") and "there is no coarse surface yet" in line[
        "message"
    ]
    shutil.rmtree(folder)


def test_a_preview_knows_the_exposure_times(tmp_path: Path) -> None:
    import tifffile

    from malus.studio.preview import preview

    angles, exposures = (0.0, 45.0, 90.0, 135.0), (0.1, 0.2, 0.1, 0.4)
    for angle, seconds in zip(angles, exposures, strict=True):
        intensity = scene(angle) * seconds
        tifffile.imwrite(tmp_path / f"{angle:.0f}.tif", np.rint(65535 * intensity).astype(np.uint16))
    paths = [tmp_path / f"{angle:.0f}.tif" for angle in angles]
    maps = preview(paths, angles, direction="ccw", zero_deg=0, response="linear", exposure_s=exposures)
    assert maps["degree_median"] == pytest.approx(0.2, abs=0.01)
    assert not [finding for finding in maps["findings"] if finding["severity"] != "note"]


@pytest.mark.parametrize("response", ["linear", "srgb", "gamma:2.2"])
def test_a_preview_of_images_that_are_negative_in_the_dark(tmp_path: Path, response: str) -> None:
    import tifffile

    from malus.studio.preview import preview

    noise = np.random.default_rng(1)
    paths = []
    for angle in ANGLES:
        intensity = np.pad(scene(angle), ((0, 0), (0, 40))) + noise.normal(0, 1e-3, (48, 104))
        paths.append(tmp_path / f"{angle}.tif")
        tifffile.imwrite(paths[-1], intensity.astype(np.float32))
    maps = preview(paths, ANGLES, direction="ccw", zero_deg=0, response=response)
    assert maps["intensity"].startswith("data:image/") and 0 < maps["degree_median"] < 1


def test_wrong_requests_are_answered_in_words(served: Served) -> None:
    for name, body, words in (
        ("create", {"path": "a.txt", "images": [], "angles_deg": []}, "ends in .toml"),
        ("create", {"path": "../a.toml", "images": [], "angles_deg": []}, "outside the folder"),
        ("preview", {"images": ["pol/pol_000.tif"], "angles_deg": [0]}, "angle"),
        ("run", {"path": "nothing.toml", "work": "w"}, "no such file"),
        ("set", "[]", "not what Studio expects"),
        ("set", "[" * 100000, "not what Studio expects"),
    ):
        status, said = served.tell(name, body)
        assert status == 400 and words in said["error"], said


def test_what_is_cut_off_when_studio_ends_is_no_failure() -> None:
    app = pytest.importorskip("malus.studio.app")

    async def ended() -> int:
        answer = asyncio.create_task(app._answer(lambda: time.sleep(0.2)))
        await asyncio.sleep(0.05)
        answer.cancel()
        return int((await answer).status_code)

    assert asyncio.run(ended()) == 503


def test_results_go_to_a_folder_of_their_own(served: Served) -> None:
    (served.folder / "mine.toml").write_text('[polarized]\nimages = "pol"\n')
    for work, words in ((".", "holds the inputs"), ("pol", "holds other files"), ("../out", "outside the folder")):
        status, said = served.tell("run", {"path": "mine.toml", "work": work})
        assert status == 400 and words in said["error"], said
    (served.folder / "mine.toml").unlink()


@pytest.mark.parametrize("name", ["options", "candidates", "photos", "tile", "relief", "mask", "overlay", "results"])
def test_nothing_is_told_without_the_cookie(served: Served, name: str) -> None:
    assert served.ask("GET", f"/api/{name}?path=pol/pol_000.tif", {"Cookie": "malus_studio=x"})[0] == 403


def test_options_outside_the_folder_are_not_read(served: Served) -> None:
    (served.folder.parent / "elsewhere.toml").write_text("[surface]\nsubsample = 3\n")
    (served.folder / "linked.toml").write_text('[polarized]\nimages = "pol"\n')
    (served.folder / "linked_options.toml").symlink_to(served.folder.parent / "elsewhere.toml")
    status, said = served.tell("option", {"path": "linked.toml", "name": "surface.subsample", "value": 2})
    assert status == 400 and "outside the folder" in said["error"]
    assert (served.folder.parent / "elsewhere.toml").read_text() == "[surface]\nsubsample = 3\n"
    for name in ("linked.toml", "linked_options.toml"):
        (served.folder / name).unlink()


def test_an_option_that_goes_back_to_its_default_leaves_no_empty_file(tmp_path: Path) -> None:
    """The page then showed no options, and every run ended with "options file … is empty", until the file was removed by hand."""
    from malus.studio import settings

    station = tmp_path / "station.toml"
    settings.change(station, "surface.subsample", 2)
    assert settings.options_of(station).surface.subsample == 2
    (row,) = (row for row in settings.listed(station) if row["name"] == "surface.subsample")
    assert (row["value"], row["allowed"]) == (2, "a whole number (1 to 64)")
    settings.change(station, "surface.subsample", None)
    assert not list(tmp_path.iterdir()) and settings.options_of(station) == Options()
    settings.file_of(station).write_text("# for the coin\n[surface]\nsubsample = 2\n")
    settings.change(station, "surface.subsample", None)
    assert settings.file_of(station).read_text() == "# for the coin\n"


def test_tiles_make_up_the_image(tmp_path: Path) -> None:
    import tifffile
    from PIL import Image

    from malus import InputError
    from malus.studio import pictures

    path = tmp_path / "large.tif"
    tifffile.imwrite(path, np.tile(np.linspace(0, 255, 1300, dtype=np.uint8), (600, 1)))
    sizes = [
        Image.open(io.BytesIO(pictures.tile(path, *place))).size
        for place in ((0, 0, 0), (0, 2, 1), (1, 1, 0), (2, 0, 0))
    ]
    assert sizes == [(512, 512), (276, 88), (138, 300), (325, 150)]
    last = np.asarray(Image.open(io.BytesIO(pictures.tile(path, 0, 2, 1))))
    assert abs(int(last[40, -1]) - 255) <= 2 and abs(int(last[40, 0]) - 255 * 1024 // 1299) <= 2
    for place in ((3, 0, 0), (0, 3, 0), (0, -1, 0)):
        with pytest.raises(InputError):
            pictures.tile(path, *place)


def test_patches_are_drawn_on_the_image_without_distortion_as_they_count(tmp_path: Path) -> None:
    """Drawn on the image as taken, they lay beside their place in the results: in the corners of wide lenses by tens of pixels."""
    from PIL import Image

    from malus.capture import undistort
    from malus.studio import app, pictures

    folder = tmp_path / "relief"
    shutil.copytree(EXAMPLE, folder, ignore=shutil.ignore_patterns("views"))
    studio = app.Studio(tmp_path, 1)
    said = studio._station({"path": "relief/station.toml"})
    assert said["lens"] is None and said["lens_known"]
    station = folder / "station.toml"
    given = Station.load(station).describe()["camera"]
    width, height, (focal, _, cx, cy) = given["width"], given["height"], given["params"]
    lens = (
        f'[camera]\nmodel = "SIMPLE_RADIAL"\nwidth = {width}\nheight = {height}\nparams = {[focal, cx + 0.5, cy + 0.5, -4.0]}\n'
        f"qvec = {_core.quaternion_of(np.array(given['rotation']))}\ntvec = {list(given['translation'])}\n"
    )
    station.write_text(re.sub(r"\[camera\]\n.*\n.*\n", lens, station.read_text()))
    said = studio._station({"path": "relief/station.toml"})
    studio.runs.close()
    told = app._lens({"lens": json.dumps(app._plain(said["lens"]))})
    assert told is not None and told[:3] == ("SIMPLE_RADIAL", width, height) and app._lens({}) is None
    assert told[3] == pytest.approx((focal, cx, cy, -4.0))

    down, right = np.mgrid[:height, :width]
    taken = (128 + 100 * np.sin(right / 15) * np.cos(down / 15)).astype(np.uint8)
    Image.fromarray(taken).save(tmp_path / "taken.png")
    part = np.s_[: min(height, 512), : min(width, 512)]  # one tile
    expected = undistort(taken, Camera(*told))[part]
    plain, straight = (
        np.asarray(Image.open(io.BytesIO(pictures.tile(tmp_path / "taken.png", 0, 0, 0, lens))), float)
        for lens in (None, told)
    )
    np.testing.assert_allclose(plain, taken[part], atol=8)
    np.testing.assert_allclose(straight[np.isfinite(expected)], expected[np.isfinite(expected)], atol=8)
    assert np.nanmax(np.abs(expected - plain)) > 50


def test_the_lens_is_known_once_a_run_has_calibrated_it(tmp_path: Path) -> None:
    """Patches stayed beside their place in the results, with a note, also after the run that had found the lens of the photos."""
    from malus.photogrammetry.control import move_model
    from malus.photogrammetry.station_pose import STATION_IMAGE
    from malus.studio import app

    folder = tmp_path / "relief"
    shutil.copytree(EXAMPLE, folder)
    station = folder / "station.toml"
    said_before = re.sub(r"\[prior\]\n.*\n", "", station.read_text())
    station.write_text(re.sub(r"\[camera\]\n.*\n.*\n", '[photos]\nfolder = "views"\n', said_before))
    studio = app.Studio(tmp_path, 1)
    said = studio._station({"path": "relief/station.toml"})
    assert (said["error"], said["lens"], said["lens_known"]) == (None, None, False)
    placed, model = folder / "placed", folder / "station_work/prior/colmap/model"
    placed.mkdir()
    unmoved = {"scale": 1.0, "rotation": np.eye(3), "translation": np.zeros(3)}
    # Of a lens that was given, the model has that of the undistorted image.
    for lens, known in (
        ("SIMPLE_RADIAL 720 480 1000 360 240 -0.3", True),
        ("PINHOLE 720 480 1000 1000 360 240", False),
    ):
        (placed / "cameras.txt").write_text(f"1 {lens}\n")
        (placed / "images.txt").write_text(f"1 1 0 0 0 0 0 0 1 {STATION_IMAGE}\n\n")
        move_model(placed, model, unmoved)
        said = studio._station({"path": "relief/station.toml"})
        expected = ("SIMPLE_RADIAL", 720, 480, (1000.0, 359.5, 239.5, -0.3)) if known else None
        assert (said["lens"], said["lens_known"]) == (expected, known)
    studio.runs.close()


def test_images_of_hundreds_of_megapixels_are_shown_and_masked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from PIL import Image

    from malus.studio import masks, pictures

    painted = np.zeros((300, 400), np.uint8)
    painted[100:200, 150:250] = 255
    Image.fromarray(painted).save(tmp_path / "large.jpg")
    Image.fromarray(painted).save(tmp_path / "named_otherwise.jpg", "PNG")
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 1000)  # instead of 89 million
    for name in ("large.jpg", "named_otherwise.jpg"):
        assert pictures.thumbnail(tmp_path / name).startswith(b"\xff\xd8")
    assert (masks.decode(encode(painted, "PNG"), (400, 300)) == painted).all()
    for content, words in ((encode(painted, "PNG"), "expected 9 x 9"), (b"no image", "is no PNG"), (b"", "is no PNG")):
        with pytest.raises(InputError, match=words):
            masks.decode(content, (9, 9))


def test_a_mask_in_any_color_is_shown(tmp_path: Path) -> None:
    from PIL import Image

    from malus.studio import masks

    green = np.zeros((6, 8, 3), np.uint8)
    green[2:4, 3:5, 1] = 128
    Image.fromarray(green).save(tmp_path / "mask.png")
    with Image.open(io.BytesIO(masks.read(tmp_path / "mask.png"))) as shown:
        assert ((np.asarray(shown) != 0) == (green[..., 1] != 0)).all()


def test_a_mask_is_shown_as_a_run_reads_it(tmp_path: Path) -> None:
    from PIL import Image

    from malus.studio import masks

    def shown(path: Path, kind: str) -> Any:
        with Image.open(io.BytesIO(masks.read(path, kind))) as image:
            return np.asarray(image)

    transparent = np.full((6, 8, 4), 255, np.uint8)
    transparent[:, :4, 3] = 0
    Image.fromarray(transparent).save(tmp_path / "alpha.png")
    assert (shown(tmp_path / "alpha.png", "mask") == transparent[..., 3]).all()
    compressed = np.zeros((40, 60), np.uint8)  # what JPEG leaves of black
    compressed[:] = np.arange(60) % 12
    compressed[10:30, 20:40] = 240 + np.arange(20) % 15
    Image.fromarray(compressed).save(tmp_path / "soft.png")
    assert (shown(tmp_path / "soft.png", "mask") == np.where(compressed >= 240, 255, 0)).all()
    labels = np.arange(48, dtype=np.uint8).reshape(6, 8) % 3
    Image.fromarray(labels).save(tmp_path / "labels.png")
    assert (shown(tmp_path / "labels.png", "labels") == labels).all()
    Image.fromarray(np.zeros((6, 8), np.uint8)).save(tmp_path / "black.png")
    assert not shown(tmp_path / "black.png", "mask").any()


@pytest.mark.parametrize("white", [0.3, 4095])
def test_floating_point_images_are_shown_as_bright_as_others(tmp_path: Path, white: float) -> None:
    import tifffile

    from malus.studio import pictures

    values = np.tile(np.linspace(0, white, 300, dtype=np.float32), (200, 1))
    values[0, 0] = np.nan
    tifffile.imwrite(tmp_path / "linear.tif", values)
    shown = pictures.displayed(tmp_path / "linear.tif")
    assert shown[100, 0, 0] == 0 and abs(int(shown[100, 150, 0]) - round(255 * 0.5 ** (1 / 2.2))) < 3
    assert shown[100, -1, 0] == 255 and shown[0, 0, 0] == 0


def test_the_edge_that_is_found_has_no_specks(tmp_path: Path) -> None:
    """A dark disc with highlights on ground with dark pebbles, painted roughly."""
    import tifffile
    from PIL import Image

    from malus.studio import masks

    v, u = np.mgrid[:240, :320]
    away = np.hypot(u - 160, v - 120)
    disc = away < 70
    seen = np.where(disc, 60, 200).astype(np.uint8) + np.random.default_rng(1).integers(0, 10, disc.shape, np.uint8)
    for row, column, value in ((60, 70, 60), (190, 230, 60), (100, 150, 210), (140, 180, 210)):
        seen[row : row + 5, column : column + 5] = value
    ring = np.hypot(u - 250, v - 80) < 6
    seen[ring & (np.hypot(u - 250, v - 80) > 2.5)] = 60
    tifffile.imwrite(tmp_path / "disc.tif", seen)
    hints = np.where(away < 115, 3, 0).astype(np.uint8)
    with Image.open(io.BytesIO(masks.cut_out(tmp_path / "disc.tif", hints, 2))) as found:
        object_ = np.asarray(found) != 0
    assert (object_ != disc)[np.abs(away - 70) > 3].sum() == 0


def test_the_edge_of_a_large_image_is_not_shifted(tmp_path: Path) -> None:
    import tifffile
    from PIL import Image

    from malus.studio import masks

    v, u = np.mgrid[:400, :6000]
    away = np.hypot(u - 4000, v - 200)
    seen = np.where(away < 120, 60, 200).astype(np.uint8)
    tifffile.imwrite(tmp_path / "disc.tif", seen)
    hints = np.where(away < 180, 3, 0).astype(np.uint8)
    with Image.open(io.BytesIO(masks.cut_out(tmp_path / "disc.tif", hints, 2))) as found:
        rows, columns = np.nonzero(np.asarray(found))
    assert abs(columns.mean() - 4000) < 1 and abs(rows.mean() - 200) < 1


def test_where_no_edge_is_found_what_is_painted_stays(tmp_path: Path) -> None:
    import tifffile

    from malus.errors import DataError
    from malus.studio import masks

    v, u = np.mgrid[:240, :320]
    seen = np.random.default_rng(1).integers(100, 110, v.shape, np.uint8)
    tifffile.imwrite(tmp_path / "same.tif", seen)
    with pytest.raises(DataError, match="no edge was found by color"):
        masks.cut_out(tmp_path / "same.tif", np.where(np.hypot(u - 160, v - 120) < 20, 3, 0).astype(np.uint8), 2)


class Slope:
    """A result: a plane at 45°, nearer by half a unit along the depth in the middle of the fused surface; no surface at the left."""

    quality: ClassVar[dict[str, Any]] = {"unit": "mm", "gsd": 0.1}
    camera = Camera("PINHOLE", 300, 200, [3000.0, 3000.0, 150.0, 100.0])

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def raster(self, name: str) -> np.ndarray:
        u = np.tile(np.arange(300), (200, 1))
        depth = 300 / (1 - (u - 150) / 3000)
        if name == "fused/depth.tif":
            depth[np.abs(u - 150) < 20] -= 0.5
        return np.where(u < 20, np.nan, depth).astype(np.float32)


def test_a_profile_that_is_picked_is_the_one_that_the_report_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from malus.studio import results

    monkeypatch.setattr(results, "Workspace", Slope)
    said = results.profile(tmp_path, (20, 100), (280, 100))
    ends = [np.array([(u - 150) / 3000, 0, 1]) * 300 / (1 - (u - 150) / 3000) for u in (20, 280)]
    assert said["along"][-1] == pytest.approx(np.linalg.norm(ends[1] - ends[0]), rel=1e-4)
    assert max(said["fused"]) == pytest.approx(0.5 / np.sqrt(2), abs=0.01)
    assert np.abs(said["prior"]).max() < 1e-3
    assert results.profile(tmp_path, (5, 100), (280, 100))["fused"][:15] == [None] * 15
    with pytest.raises(InputError, match="leaves the picture of 300 x 200 pixels"):
        results.profile(tmp_path, (5, 100), (299.6, 100))


def test_a_kept_profile_gets_a_name_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two were kept, and the first one was removed."""
    from malus.studio import results
    from malus.studio.app import Studio

    (tmp_path / "work").mkdir()
    text = '[polarized]\nimages = "pol"\n\n[[profile]]\nname = "picked 2"\nfrom = [1, 1]\nto = [9, 9]\n'
    (tmp_path / "station.toml").write_text(text)
    monkeypatch.setattr(results, "station_of", lambda root, work: "station.toml")
    studio = Studio(tmp_path, 1)
    said = studio._station({"path": "station.toml"})
    kept = studio._keep(
        {"path": "station.toml", "work": "work", "digest": said["digest"], "from": [2, 2], "to": [8, 8]}
    )
    studio.runs.close()
    assert [profile["name"] for profile in kept["values"]["profile"]] == ["picked 2", "picked 3"]


def test_comparisons_of_results_in_deep_folders_have_names_that_can_be_written(tmp_path: Path) -> None:
    from malus.studio import results
    from malus.studio.access import Root

    works = [
        tmp_path / "Ausgrabung_Tübingen_Österberg" / ("Schicht_" * 12) / name
        for name in ("2025_work", "2026_work", "w")
    ]
    for work in works:
        work.mkdir(parents=True)
    root = Root(tmp_path)
    folders = [results.folder_of_comparison(root, works[k], works[0]) for k in (1, 2)]
    for folder in folders:
        folder.with_name(f".{folder.name}.partial-0123456789abcdef").mkdir()
    assert len(set(folders)) == 2 and results.folder_of_comparison(root, works[1], works[0]) == folders[0]


def test_places_of_a_national_grid_are_told_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from malus.studio import results

    class InGrid(Slope):
        @property
        def pose(self) -> tuple[np.ndarray, np.ndarray]:
            north = {"here": 5933000.0, "also_here": 5933000.0, "a_step_aside": 5933001.0}[self.folder.name]
            return np.eye(3), np.array([-566000.0, -north, 12.0])

    monkeypatch.setattr(results, "Workspace", InGrid)
    assert results.difference(tmp_path / "here", tmp_path / "also_here")["rms"] == 0
    with pytest.raises(InputError, match="not taken from the same place"):
        results.difference(tmp_path / "here", tmp_path / "a_step_aside")


def test_photos_in_folders_are_marked_by_the_names_that_the_run_gives_them(tmp_path: Path, served: Served) -> None:
    from malus.studio import folders
    from malus.studio.access import Root

    for name in ("p10.png", "p9.png", "left/p9.png", "notes.txt", "raw.dng", "blurred.png", "masks/p9.png"):
        (tmp_path / "views" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "views" / name).write_bytes(b"")
    values = {"photos": {"folder": "views", "exclude": ["blurred*"], "masks": "views/masks"}}
    assert folders.photos_of(Root(tmp_path), tmp_path / "station.toml", values) == [
        {"path": f"views/{name}", "image": name} for name in ("left/p9.png", "p9.png", "p10.png")
    ]
    (served.folder / "marked.toml").write_text('[camera]\ncolmap_model = "sparse"\nimage = "station.jpg"\n')
    of_model = served.asked("photos?path=marked.toml")
    assert {photo["path"]: photo["image"] for photo in of_model} == {
        f"views/{name}": name for name in ("view_00.jpg", "view_04.jpg", "view_08.jpg")
    }
    (served.folder / "marked.toml").unlink()


def test_marks_are_judged_at_once(served: Served) -> None:
    model = SparseModel.read(served.folder / "sparse")
    cameras = {name: image.camera for name, image in model.images.items() if name.startswith("view")}
    names = sorted(cameras)[:3]
    ends = _core.read_points(str(EXAMPLE / "dense" / "cloud.ply"))[[1000, 40000]]

    def seen(name: str, point: np.ndarray) -> dict[str, Any]:
        fx, fy, cx, cy = cameras[name].params
        rotation, translation = cameras[name].pose()
        x, y, z = rotation @ point + translation
        return {"image": name, "x": fx * x / z + cx, "y": fy * y / z + cy}

    bar = {"distance": float(np.linalg.norm(ends[1] - ends[0])), **{end: [seen(n, p) for n in names] for end, p in zip("ab", ends, strict=True)}}  # fmt: skip
    found = marks.examined(served.folder / "sparse", [bar], names[2], 0, "a", Options())
    assert not found["problem"] and len(found["lines"]) == 2
    mark = bar["a"][2]
    for line in found["lines"]:
        assert min(np.hypot(x - mark["x"], y - mark["y"]) for x, y in line) < 20
    assert found["fits"][1]["worst_px"] < 0.01
    mark["x"] += 8
    assert marks.examined(served.folder / "sparse", [bar], names[2], 0, "a", Options())["fits"][1]["worst_px"] > 1
    assert "not known yet" in marks.examined(None, [bar], names[2], 0, "a", Options())["problem"]
    second = {**bar, "distance": 1.01 * bar["distance"]}  # with marks that are less sure, both share the contradiction
    lengths = [
        marks.examined(
            served.folder / "sparse", [bar, second], names[2], 0, "a", Options(photos={"mark_sigma_px": sigma})
        )["fits"][1]["worst_px"]
        for sigma in (0.01, 10)
    ]
    assert lengths[0] < lengths[1]


def test_control_points_are_judged_at_once(small_station: Path) -> None:
    text = small_station.read_text()
    points = _core.read_points(str(EXAMPLE / "dense" / "cloud.ply"))[[1000, 20000, 40000]]
    camera = SparseModel.read(small_station.parent / "sparse").images["station.jpg"].camera
    fx, fy, cx, cy = camera.params
    rotation, translation = camera.pose()
    for name, point in zip("ABC", points, strict=True):
        x, y, z = rotation @ point + translation
        pixel = [float(np.clip(fx * x / z + cx, 0, 199)), float(np.clip(fy * y / z + cy, 0, 159))]
        text += f'\n[[control]]\nname = "{name}"\nxyz = {point.tolist()}\npixel = {pixel}\n'
    small_station.write_text(text)
    said = marks.control(small_station, None, "", "A", Options())
    assert not said["problem"] and said["image"]["use"] == "check" and len(said["image"]["points"]) == 3
    small_station.write_text(text.replace("pixel = [", "pixel = [9"))
    assert (
        "expected a place within the polarized image"
        in marks.control(small_station, None, "", "A", Options())["problem"]
    )


def test_direction_and_zero_are_told_by_the_coarse_surface(tmp_path: Path) -> None:
    phases = pytest.importorskip("malus.studio.phases")
    folder = tmp_path / "relief"
    shutil.copytree(EXAMPLE, folder, ignore=shutil.ignore_patterns("views"))
    station = folder / "station.toml"
    said = phases.compared(Station.load(station), 2)
    assert said["severity"] == "note" and "fits the slopes" in said["message"]
    assert said["measured"].startswith("data:image/") and said["expected"].startswith("data:image/")
    text = station.read_text()
    for line, severity, words in (
        ('angle_direction = "cw"', "error", "the other angle_direction"),
        ("angle_zero_deg = 45", "warning", "is angle_zero_deg right"),
    ):
        key = line.split(" = ")[0]
        kept = "\n".join(row for row in text.splitlines() if not row.startswith(key))
        station.write_text(kept.replace("[polarized]", f"[polarized]\n{line}"))
        said = phases.compared(Station.load(station), 2)
        assert said["severity"] == severity and words in said["suggestion"], said
    station.write_text(re.sub(r"(?m)^angles_deg = .*$", 'angles_deg = "auto"', text))
    with pytest.raises(InputError, match="with all angles given"):
        phases.compared(Station.load(station), 2)


def test_the_phase_is_compared_with_a_photogrammetric_lens_too(tmp_path: Path) -> None:
    """The first parameter of BROWN is its focal length in mm."""
    phases = pytest.importorskip("malus.studio.phases")
    folder = tmp_path / "relief"
    shutil.copytree(EXAMPLE, folder, ignore=shutil.ignore_patterns("views"))
    station = folder / "station.toml"
    given = Station.load(station).describe()["camera"]
    width, height, (focal, _, cx, cy) = given["width"], given["height"], given["params"]
    lens = (
        f'[camera]\nmodel = "BROWN"\nwidth = {width}\nheight = {height}\nfocal_mm = {0.006 * focal}\npixel_mm = 0.006\n'
        f"x0_mm = {0.006 * (cx - (width - 1) / 2)}\ny0_mm = {-0.006 * (cy - (height - 1) / 2)}\n"
        f"qvec = {_core.quaternion_of(np.array(given['rotation']))}\ntvec = {list(given['translation'])}\n"
    )
    station.write_text(re.sub(r"\[camera\]\n.*\n.*\n", lens, station.read_text()))
    said = phases.compared(Station.load(station), 2)
    assert said["severity"] == "note" and "fits the slopes" in said["message"]


def test_a_phase_without_a_camera_is_refused_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    phases = pytest.importorskip("malus.studio.phases")

    class Unplaced:
        def describe(self) -> dict[str, Any]:
            return {"mosaic": None, "images": ["a.png", "b.png", "c.png"], "angles_deg": [0, 45, 90]}

    nothing = np.zeros((4, 4), np.float32), np.ones((4, 4), np.uint8), np.empty((0, 3), np.float32)
    monkeypatch.setattr(phases, "prior_upon_image", lambda station, threads: nothing)
    with pytest.raises(DataError, match="covers no pixel"):
        phases.compared(Unplaced(), 2)


# ---- the whole way in a browser ----


@pytest.fixture(scope="module")
def page(served: Served) -> Iterator[Any]:
    with chromium() as browser, opened(browser, served) as shown:
        yield shown


@needs_browser
def test_from_a_folder_to_the_report(served: Served, page: Any) -> None:
    station = served.folder / "station.toml"
    page.get_by_role("button", name="opened folder: museum").wait_for()
    page.get_by_role("button", name="pol (6 images)").click()
    page.get_by_alt_text("Phase in a circle of colors").wait_for()
    angles = [page.locator(f"#angles tbody tr:nth-child({k}) input[type=number]").input_value() for k in (1, 2, 6)]
    assert angles == ["0", "30", "150"]
    assert page.get_by_label("Pixel values are").input_value() == "linear"  # These are TIFFs.
    require_accessible(page)
    pictured(page, "images")
    page.get_by_role("button", name="Create the station").click()
    page.locator("#station").wait_for(state="visible")
    page.get_by_role("button", name="Use them").click()
    page.locator("#plan", has_text="Ready").wait_for()
    assert page.get_by_label("This station's name in the model").input_value() == "station.jpg"
    assert 'cloud = "dense/cloud.ply"' in station.read_text()
    page.get_by_role("button", name="Show the coarse surface on the image").click()
    page.locator("#overlay-note", has_text="Yellow is near").wait_for()
    page.get_by_role("button", name="Compare direction and zero of the scale with the coarse surface").click()
    page.get_by_alt_text("Phase as the coarse surface expects it").wait_for()
    require_accessible(page)
    pictured(page, "station")
    draw_a_mask(page)
    assert 'mask = "station_mask.png"' in station.read_text()
    set_options(page, served.folder)
    run_and_show(served, page)
    manifest = json.loads((served.folder / "station_work" / "manifest.json").read_text())
    assert manifest["options"]["surface"]["subsample"] == 2


def draw_a_mask(page: Any) -> None:
    go(page, "Draw")
    page.locator("[data-tool=polygon]").click()
    page.locator("#draw-stage").scroll_into_view_if_needed()
    box = page.locator("#draw-stage").bounding_box()
    assert box and 0 <= box["y"] and box["y"] + box["height"] <= 900  # in whole on the screen, with the tools
    width = min(box["width"], box["height"] * 200 / 160)
    height = width * 160 / 200
    for x, y in ((-0.45, -0.45), (0.45, -0.45), (0.45, 0.45), (-0.45, 0.45), (-0.45, -0.45)):
        page.mouse.click(box["x"] + box["width"] / 2 + x * width, box["y"] + box["height"] / 2 + y * height)
    tools = page.locator("#tools")
    tools.get_by_role("button", name="Undo").click()
    tools.get_by_role("button", name="Redo").click()
    tools.get_by_role("button", name="Find the edge").click()
    page.locator("#draw-state", has_text="The edge was found").wait_for()
    tools.get_by_role("button", name="Undo").click()
    pictured(page, "mask")
    require_accessible(page)
    tools.get_by_role("button", name="Save", exact=True).click()
    page.locator("#draw-state", has_text="Saved").wait_for()


def set_options(page: Any, folder: Path) -> None:
    go(page, "Options")
    mesh = page.get_by_label("Coarser mesh")
    mesh.fill("0")
    mesh.press("Tab")
    page.locator("#option-surface-subsample-wrong", has_text="expected").wait_for()
    assert not (folder / "station_options.toml").exists()
    mesh.fill("2")
    mesh.press("Tab")
    page.get_by_role("button", name="Coarser mesh: back to the default").wait_for()
    assert (folder / "station_options.toml").read_text() == "[surface]\nsubsample = 2\n"
    require_accessible(page)
    pictured(page, "options")


def run_and_show(served: Served, page: Any) -> None:
    go(page, "Run")
    page.get_by_label("Fusion").select_option("grid")
    page.get_by_role("button", name="Add to the queue").click()
    with paused(served):
        page.locator("p[data-state]", has_text="left").wait_for()
        page.get_by_role("button", name="Cancel").click()
        page.locator("p[data-state]", has_text="canceled").wait_for()
    page.get_by_role("button", name="Resume").press("Enter")
    page.get_by_role("article").get_by_text("canceled").wait_for(state="detached")
    wait_for(page, lambda: page.evaluate("document.activeElement.textContent") in ("Cancel", "Show the report"))
    pictured(page, "run")
    require_accessible(page)
    page.get_by_role("button", name="Show the report").click(timeout=RUN_MS)
    report = page.frame_locator("iframe")
    report.get_by_text("Confidence").first.wait_for()
    picture = report.locator("img").first
    wait_for(page, lambda: picture.evaluate("image => image.naturalWidth") > 0)
    pictured(page, "report")
    page.get_by_role("button", name="Profile").first.click()
    page.locator("svg.profile").first.wait_for()
    picture = page.locator(".picked img")
    picture.evaluate("image => image.decode()")
    box = picture.bounding_box()
    assert box
    chart = page.locator("svg.profile").first
    first = chart.get_attribute("aria-label")
    for x in (0.25, 0.75):
        picture.click(position={"x": x * box["width"], "y": 0.5 * box["height"]})
    page.locator(".picked path").first.wait_for(state="attached")
    assert abs(int(page.get_by_label("to x").input_value()) - 150) <= 1
    wait_for(page, lambda: chart.get_attribute("aria-label") != first)
    require_accessible(page)
    pictured(page, "profile")
    keep_only_in_its_own_station(served, page)


def keep_only_in_its_own_station(served: Served, page: Any) -> None:
    page.get_by_role("button", name="Keep it in the open station").click()
    page.get_by_text("Kept in station.toml; the next run reports it.").wait_for()
    said = served.asked("station?path=station.toml")
    (kept,) = said["values"]["profile"]
    assert kept["name"] == "picked 1" and abs(kept["to"][0] - 150) <= 1
    (served.folder / "other.toml").write_text(said["text"])
    asked = {"path": "other.toml", "digest": said["digest"], "work": "station_work", "from": [1, 1], "to": [9, 9]}
    status, answer = served.tell("keep", asked)
    assert status == 400 and "station_work: is a result of station.toml, expected one of other.toml" in answer["error"]
    (served.folder / "other.toml").unlink()


@needs_browser
def test_patches_by_keyboard_alone_and_undone(served: Served, page: Any) -> None:
    station = served.folder / "station.toml"
    draw(page, "patch")
    page.locator("[data-tool=box]").focus()
    page.keyboard.press("Enter")
    page.locator("#draw-stage").focus()
    for key in ("ArrowLeft", "Enter", "ArrowRight", "ArrowRight", "ArrowDown", "Shift+ArrowDown", "Enter"):
        page.keyboard.press(key)
    page.get_by_role("group", name="patch 1").wait_for()
    assert "box = [97, 80, 103, 84]" in station.read_text()
    page.keyboard.press("Tab")  # the image does not keep the keyboard
    assert page.evaluate("document.activeElement.closest('#draw-side') !== null")
    pictured(page, "patch")
    page.get_by_role("button", name="Undo the last change").click()
    page.get_by_role("group", name="patch 1").wait_for(state="detached")
    assert "patch" not in station.read_text()
    page.get_by_role("button", name="Redo the change").click()
    page.get_by_role("group", name="patch 1").wait_for()
    assert "box = [97, 80, 103, 84]" in station.read_text()


@needs_browser
def test_labels_and_distances_are_drawn(served: Served, page: Any) -> None:
    go(page, "Draw")
    what, stage = page.locator("#draw-what"), page.locator("#draw-stage")
    what.select_option("labels")
    page.locator("[data-tool=brush]").click()
    stage.drag_to(stage, source_position={"x": 200, "y": 200}, target_position={"x": 260, "y": 220})
    page.locator("#tools").get_by_role("button", name="Save", exact=True).click()
    page.locator("#draw-state", has_text="Saved").wait_for()
    assert 'reflection = "station_labels.png"' in (served.folder / "station.toml").read_text()
    what.select_option("scale")
    page.get_by_role("button", name="Add a known distance").click()
    for name in ("views/view_00.jpg", "views/view_04.jpg"):
        page.locator("#draw-image").select_option(name)
        page.get_by_role("button", name="Mark end a").click()
        stage.click(position={"x": 300, "y": 250})
        page.get_by_text(re.compile(rf"in \d photos: .*{name[6:]}")).wait_for()
    # The mark in the first photo makes a line in the second one.
    found = served.tell("marks", {"path": "station.toml", "image": "view_04.jpg", "distance": 0, "end": "a"})[1]
    assert len(found["lines"]) == 1
    pictured(page, "scale")


#: What is said of points too few to tell how sure the camera's place is.
OF_THREE_POINTS = {
    "problem": "", "lines": [], "datum": None,
    "image": {"use": "resection", "center_sigma": None, "doubtful": None, "points": [{"name": "T2", "check": False, "du_px": 0, "dv_px": 0}]},
}  # fmt: skip


def erase(page: Any, x: int, y: int) -> None:
    page.locator("[data-tool=erase]").click()
    stage = page.locator("#draw-stage")
    stage.drag_to(stage, source_position={"x": x, "y": y}, target_position={"x": x + 40, "y": y + 20})


@needs_browser
def test_what_is_drawn_outlives_changes_by_others(served: Served, page: Any) -> None:
    from playwright.sync_api import expect

    station, mask = served.folder / "station.toml", served.folder / "station_mask.png"
    go(page, "Draw")
    page.locator("#draw-what").select_option("mask")
    save = page.locator("#tools").get_by_role("button", name="Save", exact=True)
    # Another program changes the station file: the mask is saved, and what the program wrote stays.
    erase(page, 210, 200)
    with station.open("a") as file:
        file.write("\n# by another program\n")
    before = mask.read_bytes()
    save.click()
    page.locator("#draw-state", has_text="Saved").wait_for()
    erased = mask.read_bytes()
    assert "# by another program" in station.read_text() and erased != before
    # Another page saves a mask: none of the two is lost, and who draws is asked.
    erase(page, 260, 240)
    mask.write_bytes(before)
    go(page, "Station")
    page.locator("#message", has_text="was changed by another program or page since it was shown here").wait_for()
    assert mask.read_bytes() == before
    go(page, "Draw")
    page.get_by_role("button", name="Take the file's").wait_for()
    pictured(page, "conflict")
    page.get_by_role("button", name="Keep mine").click()
    page.locator("#draw-state", has_text="Saved").wait_for()
    assert mask.read_bytes() not in (before, erased)
    # What was not painted upon is shown as it has become.
    go(page, "Station")
    mask.write_bytes(before)
    go(page, "Draw")
    erase(page, 210, 200)
    save.click()
    page.locator("#draw-state", has_text="Saved").wait_for()
    assert mask.read_bytes() == erased
    # A field that is changed after another program changed the file.
    go(page, "Station")
    page.locator("#plan", has_text=re.compile("Ready|cannot run yet")).wait_for()
    with station.open("a") as file:
        file.write("# once more\n")
    title = page.get_by_role("textbox", name="Name of the object")
    title.fill("Other")
    title.press("Tab")
    page.locator("#message", has_text="please make your last change once more").wait_for()
    title.fill("Other")
    title.press("Tab")
    expect(page.locator("#station-text")).to_have_value(re.compile("Other"), timeout=PATIENCE_MS)
    assert "# once more" in station.read_text() and 'name = "Other"' in station.read_text()


@needs_browser
def test_control_points_are_marked(served: Served, page: Any) -> None:
    go(page, "Draw")
    what = page.locator("#draw-what")
    what.select_option("scale")
    page.get_by_role("button", name="Remove").click()  # both would give the size
    what.select_option("control")
    page.get_by_label("Coordinates, a point a line").fill("T1 10.5 20 3")
    what.select_option("scale")  # what is typed outlives that the list is drawn anew
    page.get_by_role("button", name="Add a known distance").wait_for()
    what.select_option("control")
    page.get_by_role("button", name="Take these coordinates").click()
    page.get_by_role("button", name="Mark it").click()
    page.locator("#draw-stage").click(position={"x": 300, "y": 250})
    page.get_by_text(re.compile(r"Off by [\d.]+ px in the polarized image")).wait_for()
    pictured(page, "control")
    require_accessible(page)
    text = (served.folder / "station.toml").read_text()
    assert 'name = "T1"' in text and "xyz = [10.5, 20, 3]" in text and "pixel = [" in text
    page.get_by_label("X", exact=True).fill("")
    page.get_by_label("X", exact=True).press("Tab")
    page.get_by_text("Expected a number; it stays 10.5.").wait_for()
    named = page.locator("#draw-side").get_by_label("name", exact=True)
    named.fill("")
    named.press("Tab")
    page.get_by_role("group", name="point 1").get_by_text(re.compile(r"Off by [\d.]+ px")).wait_for()
    text = (served.folder / "station.toml").read_text()
    assert "T1" not in text and "xyz = [10.5, 20, 3]" in text
    page.route("**/api/control", lambda route: route.fulfill(json=OF_THREE_POINTS))
    named.fill("T2")
    named.press("Tab")
    page.get_by_text("The camera's pose follows from 1 point.").wait_for()
    page.unroute("**/api/control")
    page.get_by_role("button", name="Remove").click()
    page.get_by_text("Mark each point where the image shows it.").wait_for()
    assert "[[control]]" not in (served.folder / "station.toml").read_text()


@needs_browser
def test_several_stations_are_queued_and_two_results_compared(served: Served, page: Any) -> None:
    text = (served.folder / "station.toml").read_text()
    for name in ("first.toml", "second.toml"):
        (served.folder / name).write_text(text.split("[[scale]]")[0])
    other = page.context.new_page()
    other.set_default_timeout(PATIENCE_MS)
    other.goto(served.entrance)
    go(other, "Run")
    other.get_by_label("Run station.toml").uncheck()
    other.get_by_label("Fusion").select_option("grid")
    for name in ("first.toml", "second.toml"):
        other.get_by_label(f"Run {name}").check()
    other.get_by_role("button", name="Add to the queue").click()
    with paused(served):
        other.locator("p[data-state]", has_text="left").wait_for()
        other.locator("p[data-state]", has_text="waiting").wait_for()
        other.close()  # which ends no run
    deadline = time.monotonic() + RUN_MS / 1000
    while {run["state"] for run in served.asked("runs")} != {"done"}:
        assert time.monotonic() < deadline
        time.sleep(0.2)
    go(page, "Results")
    for name in ("first_work", "second_work"):
        page.get_by_label(f"Compare {name}").check()
    page.get_by_role("button", name="Compare the two that are ticked").click()
    page.get_by_text("RMS").wait_for()
    require_accessible(page)
    pictured(page, "compared")
    said = served.asked("difference?a=first_work&b=second_work")
    assert said["rms"] == 0 and said["unit"] == "mm"


@needs_browser
@pytest.mark.skipif(find_spec("py4dgeo") is None, reason="py4dgeo is not installed")
def test_two_dates_are_compared(served: Served, page: Any, finished_grid: Path) -> None:
    for name in ("earlier", "later"):
        shutil.copytree(finished_grid, served.folder / "dates" / name)
    go(page, "Results")
    for name in ("earlier", "later"):
        page.get_by_label(f"Compare dates/{name}").check()
    page.get_by_role("button", name="Compare the two that are ticked").click()
    page.get_by_label("The earlier one is").select_option("dates/later")
    page.get_by_label("Both stand in one frame already").check()
    page.get_by_role("button", name="Find what changed").click()
    run = page.get_by_role("article").filter(has_text="change_dates_later_dates_earlier")
    run.get_by_role("button", name="Show the report").click(timeout=RUN_MS)
    page.frame_locator("iframe").get_by_role("heading", level=1).wait_for()
    require_accessible(page)
    pictured(page, "dates")
    figures = json.loads((served.folder / "change_dates_later_dates_earlier" / "change.json").read_text())
    assert figures["before"]["workspace"].endswith("later") and not figures["regions"]
    page.get_by_role("button", name="Report", exact=True).first.click()  # of a run, which hides the comparison's page
    page.get_by_role("button", name="change_dates_later_dates_earlier").click()
    page.frame_locator("iframe").get_by_role("heading", name="what changed").wait_for()


@needs_browser
def test_large_type_and_dark_colors(page: Any) -> None:
    page.emulate_media(color_scheme="dark")
    page.set_viewport_size({"width": 640, "height": 450})  # what 200 % leaves of 1280 x 900
    for name in ("Images", "Station", "Draw", "Options", "Run", "Results"):
        go(page, name)
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), name
        require_accessible(page)
        pictured(page, f"dark_{name}")
    page.get_by_role("button", name="Report", exact=True).first.click()
    heading = page.locator("#result-view h3")
    heading.wait_for()
    box = heading.bounding_box()
    assert box and -1 < box["y"] < 400  # what was asked for is on the screen, to parts of a pixel
    assert page.evaluate("document.activeElement.tagName") == "H3"
    page.set_viewport_size({"width": 390, "height": 844})  # a phone
    go(page, "Run")
    assert page.evaluate("[...document.querySelectorAll('.scroll')].every(one => one.scrollWidth <= one.clientWidth)")
