"""The documentation is tested: its commands and programs run, its files can be read, and every link has a target."""

from __future__ import annotations

import argparse
import ast
import inspect
import re
import shlex
import shutil
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image
from scipy import ndimage

import malus
from conftest import (
    PATCH,
    QUICK,
    QUICK_WORDS,
    TINY_PATCH,
    TINY_WINDOW,
    WINDOW,
    cloud_in_meters,
    cut_out,
    demo_with_photos,
    malus_here,
    metashape_cameras,
    run_program,
)
from malus import InputError, Station, _core
from malus.campaign import Campaign
from malus.object import Object

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs").rglob("*.md")) + [ROOT / "README.md", ROOT / "ARCHITECTURE.md"]
TUTORIALS = sorted((ROOT / "docs/tutorials").glob("*.md"))
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
#: The kinds of blocks. Tests run, read or build all of them except text: listings, formulas, and the syntax of commands.
KINDS = {"console", "python", "toml", "cpp", "cmake", "text"}
MARK = re.compile(r"<!-- (run by|read as)( a part of)? (\S+) -->\n\n```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def prepare(kind: str, target: Path) -> None:
    """Make the folder that a page begins with from the example station."""
    if kind == "examples/relief without station.toml":
        cut_out(target, WINDOW, PATCH)  # large enough to test the commands
        (target / "station.toml").unlink()
        return
    if kind.startswith("examples/"):
        shutil.copytree(ROOT / kind, target, dirs_exist_ok=True, ignore=shutil.ignore_patterns("views"))
        return
    if kind == "what Metashape exports of examples/relief":
        cut_out(target, WINDOW, PATCH)
        station = target / "station.toml"
        (target / "cameras.xml").write_text(metashape_cameras(station, "station.jpg"))
        cloud_in_meters(station, target / "cloud.ply")
        station.unlink()
        return
    assert kind.startswith("one mosaic image")
    cut_out(target, WINDOW, PATCH)
    # Each pixel of the mosaic is one sample, at 0 to 135 degrees, of the sinusoid fitted to the six images.
    stack = np.stack([tifffile.imread(path) for path in sorted((target / "pol").iterdir())]).astype(float)
    phases = 2 * np.radians(range(0, 180, 30))
    mean, c, s = stack.mean(0), (stack.T @ np.cos(phases)).T / 3, (stack.T @ np.sin(phases)).T / 3
    mosaic = np.zeros(mean.shape, np.uint16)
    for (row, column), angle in np.ndenumerate(np.array([[90, 45], [135, 0]])):
        a = 2 * np.radians(angle)
        value = mean + c * np.cos(a) + s * np.sin(a)
        mosaic[row::2, column::2] = np.clip(np.rint(value), 0, 65535)[row::2, column::2]
    tifffile.imwrite(target / "mosaic.tif", mosaic)
    shutil.rmtree(target / "pol")
    (target / "station.toml").unlink()


def require_refined_rim(folder: Path) -> None:
    """At the coin's rim, its step and the beads, the cloud's slopes are wrong; elsewhere on the coin they support mirror reflection."""
    work = malus.Workspace(folder / "out/coin")
    truth = np.asarray(_core.read_raster(str(folder / "coin/truth/depth.tif")), float)
    gsd = float(np.nanmedian(truth)) / work.camera.params[0]

    def detail_rms(name: str) -> float:
        """RMS of the depth's error without low frequencies (Gaussian of 8 px), 8 px inside the object, in GSD."""
        error = (np.asarray(work.raster(name), float) - truth) / gsd
        inside = ndimage.binary_erosion(np.isfinite(error), iterations=8)
        error = np.where(inside, error - np.nanmedian(error[inside]), 0.0)
        low = ndimage.gaussian_filter(error, 8) / np.maximum(ndimage.gaussian_filter(inside.astype(float), 8), 1e-6)
        return float(np.sqrt(np.mean((error - low)[inside] ** 2)))

    # Measured: .19. With only what the prior's slopes explain at each place: .37. The prior itself: .53.
    assert detail_rms("fused/depth.tif") < 0.25 < 0.5 < detail_rms("prior/depth.tif")
    assert work.quality["confidence"]["level"] == "partial", "what the prior's slopes do not confirm is not certain"


#: What else must hold of the files that a tutorial leaves.
RESULTS = {"coin": require_refined_rim}
#: Pages whose stations are refined without the fits that take most of the time. The coin's tutorial runs with the default options.
QUICK_PAGES = ("first-station", "whole-object")
QUICK_TABLE = "\n[options.refine]\n" + "".join(f"{name} = false\n" for name in QUICK)


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_commands_and_programs_of_a_tutorial_run(page: Path, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    text = page.read_text(encoding="utf-8")
    if "<!-- two finished workspaces" in text:
        pytest.importorskip("py4dgeo")
        pytest.importorskip("cv2")
        for work in request.getfixturevalue("dates"):
            shutil.copytree(work, tmp_path / work.name)
    for name in re.findall(r"<!-- two stations: (\S+) -->", text):
        pytest.importorskip("xatlas")
        for side in ("front", "side"):
            shutil.copytree(request.getfixturevalue("tiny_station_source"), tmp_path / name / side)
    for name, kind in re.findall(r"<!-- folder: (\S+) = (.*?) -->", text):
        prepare(kind, tmp_path / name)
    program = ""
    for language, block in BLOCK.findall(text):
        if language == "toml":
            tomllib.loads(block)
            if name := re.match(r"# append: (\S+)\n", block):
                with (tmp_path / name[1]).open("a", encoding="utf-8") as file:
                    file.write(
                        "\n"
                        + block
                        + (QUICK_TABLE if page.stem in QUICK_PAGES and name[1].endswith("object.toml") else "")
                    )
        elif language == "console":
            for line in block.splitlines():
                assert line.startswith("$ malus "), line
                words = shlex.split(line)[2:]
                quick = QUICK_WORDS if page.stem in QUICK_PAGES and words[0] == "run" else ()
                outcome = malus_here(*words, *quick)
                assert outcome.code == 0, f"{line}\n{outcome.err}"
        elif language == "python":
            program += block
    if program:
        outcome = run_program(sys.executable, "-c", program, cwd=tmp_path)
        assert outcome.code == 0, outcome.err
    if page.stem in RESULTS:
        RESULTS[page.stem](tmp_path)


def test_every_block_is_run_or_is_text() -> None:
    """Some test runs, reads or builds every command, program and file on a page; the kind of any other block is text."""
    wrong = []
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        marked = {block for *_, block in MARK.findall(text)}
        whole = page in TUTORIALS or page.name == "README.md"  # tests run these pages from beginning to end
        for kind, block in BLOCK.findall(text):
            known = kind in KINDS and (kind in ("text", "cpp", "cmake") or whole or block in marked)
            if not known:
                wrong.append(f"{page.name}: {kind or 'no kind'}: {block[:60]!r}")
        rest = BLOCK.sub("", text)
        wrong += [f"{page.name}: not between ``` lines: {line}" for line in re.findall(r"\n\n    +(\S.*)", rest)]
        wrong += [f"{page.name}: a block that does not end" for _ in re.findall(r"^\s*```", rest, re.MULTILINE)]
    assert not wrong


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md"], ids=lambda page: str(page.relative_to(ROOT)))
def test_lines_of_a_page_are_short(page: Path) -> None:
    """Rows of tables and commands, which cannot be divided, may be longer."""
    long, kind = [], ""
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        if fence := re.match(r"\s*```(\w*)$", line):
            kind = fence[1]
        elif len(line) > 120 and kind != "console" and not line.lstrip().startswith("|"):
            long.append(number)
    assert not long


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_lists_within_lists_are_indented_by_four(page: Path) -> None:
    """With less, the site shows the inner list as further items of the outer one, which counts them."""
    assert not re.findall(r"^ {1,3}(?:[-*]|\d+\.) .*", BLOCK.sub("", page.read_text(encoding="utf-8")), re.MULTILINE)


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md"], ids=lambda page: str(page.relative_to(ROOT)))
def test_rows_of_tables_are_lines(page: Path) -> None:
    """Rows that were joined to one paragraph are no table."""
    text = BLOCK.sub("", page.read_text(encoding="utf-8"))
    assert not re.findall(r"^ *\|.*\| +\|(?: ?-{3,} ?\|)+.*", text, re.MULTILINE)


def test_marked_commands_are_in_the_test_that_their_page_names() -> None:
    for page in PAGES:
        for how, _, file, kind, block in MARK.findall(page.read_text(encoding="utf-8")):
            if how != "run by":
                continue
            assert kind == "console"
            test = (ROOT / file).read_text(encoding="utf-8")
            for line in block.splitlines():
                words = shlex.split(line.removeprefix("$ ").split(" >")[0])[1:]
                names = [word for word in words if re.fullmatch(r"(--)?[a-zA-Z0-9_.]+", word) and not word.isupper()]
                names = [word for word in names if "." not in word or word.startswith("--")]
                missing = [word for word in names if f'"{word}"' not in test and not word.isdecimal()]
                assert names and not missing, f"{page.name}: {line}: {file} has no {missing}"


def stations_of_a_page(page: str, folder: Path) -> None:
    """Make the inputs that the files on a page name."""
    if page in ("station-file.md", "metashape.md"):
        shutil.copytree(ROOT / "examples/relief", folder, dirs_exist_ok=True)
        for name in ("cloud.ply", "scan.ply"):
            shutil.copy(folder / "dense/cloud.ply", folder / name)
        shutil.copytree(folder / "sparse", folder / "dense/sparse")
        (folder / "dense/stereo/depth_maps").mkdir(parents=True)
        (folder / "dense/stereo/depth_maps/view_00.jpg.geometric.bin").touch()
    elif page == "batch.md":
        for name in ("objects/vase", "objects/plate", "loans/coin"):
            cut_out(folder / name, TINY_WINDOW, TINY_PATCH)
    else:
        station, _ = demo_with_photos(folder / "st1")
        station.write_text(station.read_text().split("[photos]")[0] + '[photos]\nfolder = "../views"\n')
        shutil.copytree(folder / "st1", folder / "st2")
        shutil.copytree(ROOT / "examples/relief/views", folder / "views")
        shutil.copy(ROOT / "examples/relief/dense/cloud.ply", folder / "scan.ply")


@pytest.mark.parametrize("page", ["station-file.md", "tutorials/metashape.md", "batch.md", "object.md"])
def test_files_on_a_page_are_read(page: str, tmp_path: Path) -> None:
    """Malus reads them, not just a TOML parser: it must know every key and accept every value."""
    stations_of_a_page(Path(page).name, tmp_path)
    readers = {"station.toml": Station.load, "campaign.toml": Campaign.load, "object.toml": Object.load}
    count = 0
    for how, part, name, kind, block in MARK.findall((ROOT / "docs" / page).read_text(encoding="utf-8")):
        if how == "read as":
            assert kind == "toml"
            if size := re.search(r"^width = (\d+)\nheight = (\d+)", block, re.MULTILINE):
                for image in (tmp_path / "pol").iterdir():
                    Image.new("L", (int(size[1]), int(size[2]))).save(image, compress_level=1)
            (tmp_path / name).write_text(('[polarized]\nimages = "pol"\n' if part else "") + block)
            readers[name](tmp_path / name)
            (tmp_path / name).write_text((tmp_path / name).read_text() + "\n[nothing]\n")
            with pytest.raises(InputError):
                readers[name](tmp_path / name)
            count += 1
    assert count > 0


def _commands_of(text: str) -> list[list[str]]:
    """The words of everything on a page that begins with `malus` and one of its commands."""
    # Code in single backticks may span two lines.
    lines = [line.removeprefix("$ ").strip() for _, block in BLOCK.findall(text) for line in block.splitlines()]
    lines += re.findall(r"(?<!`)`([^`]+)`(?!`)", BLOCK.sub("", text))
    lines = [re.sub(r"\s+", " ", line).split(" #")[0].removeprefix(".venv/bin/") for line in lines]
    return [words for line in lines if len(words := line.split()) > 1 and words[0] == "malus"]


def test_every_command_on_the_pages_exists() -> None:
    """Commands that no test runs must at least exist, and so must their options."""
    from malus.cli.arguments import command_line

    (choices,) = (
        action.choices for action in command_line()._actions if isinstance(action, argparse._SubParsersAction)
    )
    wrong, seen = [], set()
    for page in PAGES:
        for words in _commands_of(page.read_text(encoding="utf-8")):
            # `malus demo relief|bust|coin|glass`, `malus COMMAND …`: words in capitals are placeholders.
            command = choices.get(words[1])
            if command is None:
                if not words[1].isupper() and words[1].isalpha():
                    wrong.append(f"{page.name}: {' '.join(words)}")
                continue
            seen.add(words[1])
            options = {
                re.split(r"[=\]]", word.strip("[]…"))[0] for word in words[2:] if word.strip("[").startswith("-")
            }
            unknown = options - set(command._option_string_actions) - {"--help"}
            wrong += [f"{page.name}: malus {words[1]} {option}" for option in sorted(unknown)]
    assert not wrong
    assert len(seen) > 12, seen


def test_defaults_of_options_on_the_pages_are_those_of_the_program() -> None:
    """As pages state them: `section.option` (value)."""
    defaults = {name: default for name, _, default, _ in malus.Options.describe()}
    pages = [page for page in PAGES if page.parent.name != "decisions"]  # which tell of their time
    text = "\n".join(page.read_text(encoding="utf-8") for page in pages)
    stated = re.findall(r"`([a-z]+\.[a-z_]+)`\s\((\d[\d ]*(?:\.\d+)?)\)", text)
    assert len(stated) > 4
    assert not [entry for entry in stated if defaults[entry[0]] != float(entry[1].replace(" ", ""))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_files_on_a_page_are_toml(page: Path) -> None:
    for language, block in BLOCK.findall(page.read_text(encoding="utf-8")):
        if language == "toml":
            tomllib.loads(block)


def test_station_file_commands_and_program_of_the_readme_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = dict(BLOCK.findall((ROOT / "README.md").read_text(encoding="utf-8")))
    prepare("examples/relief", tmp_path)
    (tmp_path / "station.toml").write_text(blocks["toml"])
    outcome = malus_here("check", "station.toml")
    assert outcome.code == 0, outcome.err
    assert "\nno warnings\n" in outcome.out and "\n\n" not in outcome.out
    # The commands and the program run on a small window; `given` defines the reader's images and angles, which the program uses.
    small = tmp_path / "small"
    cut_out(small, TINY_WINDOW, TINY_PATCH)
    monkeypatch.chdir(small)
    for line in blocks["console"].splitlines():
        words = shlex.split(line, comments=True)
        assert words[:2] == ["$", ".venv/bin/malus"], line
        outcome = malus_here(*words[2:], *(QUICK_WORDS if words[2] == "run" else ()))
        assert outcome.code == 0, outcome.err
    given = "import numpy\nimages, angles_rad = [numpy.full((4, 5), 0.5, numpy.float32)] * 3, [0, 1, 2]\n"
    # With the options of the commands, the program keeps their steps.
    refined = 'fusion="refined"'
    assert refined in blocks["python"]
    program = given + blocks["python"].replace(refined, f"{refined}, refine={QUICK}")
    outcome = run_program(sys.executable, "-c", program, cwd=small)
    assert outcome.code == 0, outcome.err
    assert (small / "relief.glb").stat().st_size > 1000


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_has_a_target(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith(("http:", "https:", "mailto:")):
            continue
        path, _, anchor = target.partition("#")
        file = page.parent / path if path else page
        assert file.exists(), f"{page.name} links to {target}"
        if anchor:
            headings = re.findall(r"^#+ (.*)$", file.read_text(encoding="utf-8"), re.MULTILINE)
            anchors = {re.sub(r"[^\w\- ]", "", heading).strip().lower().replace(" ", "-") for heading in headings}
            assert anchor in anchors, f"{page.name} links to {target}; there are {sorted(anchors)}"


def test_cpp_on_the_pages_is_what_the_tests_build() -> None:
    program = (ROOT / "tests/consumer/main.cpp").read_text(encoding="utf-8")
    blocks = [
        block
        for page in PAGES
        for language, block in BLOCK.findall(page.read_text(encoding="utf-8"))
        if language == "cpp"
    ]
    assert blocks and all(block in program for block in blocks)
    build = (ROOT / "tests/consumer/CMakeLists.txt").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```cmake\n(.*?)^```", (ROOT / "README.md").read_text(encoding="utf-8"), re.M | re.DOTALL)
    assert block.replace("(app ", "(consumer ").splitlines() == [
        line for line in build.splitlines() if "malus" in line and "project" not in line
    ]


def test_help_explains_every_command_and_every_argument() -> None:
    from malus.cli.arguments import command_line

    (commands,) = (part for part in command_line()._actions if isinstance(part, argparse._SubParsersAction))
    without = [name for name, command in commands.choices.items() if not command.description]
    for name, command in commands.choices.items():
        without += [f"{name} {part.metavar or part.dest}" for part in command._actions if not part.help]
    assert not without


def test_help_of_an_option_stands_alone() -> None:
    """Editors show the help of an option without that of the option before it."""
    options = (ROOT / "python/malus/_option_types.py").read_text(encoding="utf-8")
    helps = re.findall(r'^    """(.*)"""$', options, re.MULTILINE)
    assert len(helps) > 150
    leaning = r"… |and |of |the same|such |they |it |their |its "
    assert not [text for text in helps if re.match(leaning, text) or text.endswith("…")]


def test_troubleshooting_quotes_messages_that_exist() -> None:
    sources = "\n".join(
        path.read_text(encoding="utf-8")
        for folder in ("cpp", "python/malus")
        for path in (ROOT / folder).rglob("*")
        if path.suffix in (".cpp", ".h", ".py")
    )
    # Messages are written as several literals that the compiler joins.
    sources = re.sub(r'"\s*\n\s*(?:<<\s*|\+\s*|f)?"', "", sources)
    quotes = _explained()
    assert len(quotes) > 8
    missing = [quote for quote in quotes if any(part.strip() not in sources for part in quote.split("…"))]
    assert not missing


def _explained() -> list[str]:
    """The messages, or parts of them with … between, that the tables of troubleshooting explain: code of several words in their first
    columns.
    """
    pages = ("troubleshooting.md", "capture.md")
    tables = "\n".join((ROOT / "docs" / page).read_text(encoding="utf-8") for page in pages)
    rows = re.findall(r"^\| (.*?) \|", tables, re.MULTILINE)
    return [quote for row in rows for quote in re.findall(r"`([^`]+)`", row) if " " in quote]


#: In C++: a comment, a character, a raw string, a string (the group), the end of a statement.
_CPP_TOKEN = re.compile(r"""//[^\n]*|'(?:\\.|[^'\\])'|R"\(.*?\)"|"((?:[^"\\]|\\.)*)"|;""", re.DOTALL)
_CPP_WARNING = re.compile(
    r"LogLevel::warning|ConfidenceLevel::(?:partial|low)|Severity::(?:caution|warning)|warnings\.(?:push|emplace)_back"
)


def _warnings_of_cpp(text: str) -> Iterator[str]:
    """The strings of each statement that warns or lowers the confidence, joined."""
    text = re.sub(r"^#include.*", "", text, flags=re.MULTILINE)
    strings: list[str] = []
    start = 0
    for token in _CPP_TOKEN.finditer(text):
        if token[0] == ";":
            if _CPP_WARNING.search(text[start : token.start()]):
                yield "".join(strings)
            strings, start = [], token.end()
        elif token[1] is not None:
            strings.append(token[1])


def _warnings_of_python(text: str) -> Iterator[str]:
    """The strings of each call of log("warning", …) or warnings.append(…), joined."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Call) and node.args:
            first = node.args[0]
            logs = isinstance(first, ast.Constant) and first.value == "warning"
            if logs or ast.unparse(node.func).endswith("warnings.append"):
                words = (part.value for part in ast.walk(node) if isinstance(part, ast.Constant))
                yield "".join(word for word in words if isinstance(word, str))


def test_every_warning_is_explained() -> None:
    readers = ((ROOT / "cpp", "*.cpp", _warnings_of_cpp), (ROOT / "python/malus", "*.py", _warnings_of_python))
    said = [
        warning
        for folder, names, warnings_of in readers
        for path in sorted(folder.rglob(names))
        for warning in warnings_of(path.read_text(encoding="utf-8"))
        if len(re.findall("[a-z]{2,}", warning)) > 3  # otherwise the sentence is made elsewhere
    ]
    assert len(said) > 80
    quotes = [quote.split("…") for quote in _explained()]
    assert not [
        warning for warning in said if not any(all(part.strip() in warning for part in quote) for quote in quotes)
    ]


def test_deliverables_describe_every_file_of_a_run() -> None:
    """Units and values of nine rasters stood nowhere: the zeniths are in radians, and 64 in valid.png is saturated."""
    page = (ROOT / "docs" / "deliverables.md").read_text(encoding="utf-8")
    for fusion in ("grid", "refined"):
        for name, _, leaves, may_leave in _core.describe_run(malus.Options(fusion=fusion).to_json(), None):
            for file in (*leaves, *may_leave) if name not in ("paper", "report") else ():
                told = f"`{Path(file).name}`" in page and f"`{Path(file).parent}/" in page
                assert f"`{file}`" in page or told, f"{name}: {file}"


def test_the_python_reference_has_every_public_name() -> None:
    text = (ROOT / "docs/reference/python.md").read_text(encoding="utf-8")
    names = set(re.findall(r"^        - (\w+)$", text, re.MULTILINE))
    modules = set(re.findall(r"^::: malus\.(\w+)$", text, re.MULTILINE))
    of_steps = {name for name in malus.__all__ if inspect.ismodule(getattr(malus, name))} - {"photogrammetry"}
    assert of_steps <= modules
    assert names == set(malus.__all__) - of_steps - {"photogrammetry", "__version__"}
