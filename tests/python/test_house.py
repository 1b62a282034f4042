"""Rules for the source: short functions, no circular imports, few installed headers, American spelling."""

from __future__ import annotations

import ast
import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from conftest import LONGEST_FIRST
from malus.units import METERS

ROOT = Path(__file__).parents[2]
LONGEST = 80
MOST_INSTALLED_HEADERS = 40


def python_functions(file: Path) -> Iterator[tuple[str, int]]:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            assert node.end_lineno is not None
            yield node.name, node.end_lineno - node.lineno + 1


def cpp_functions(file: Path) -> Iterator[tuple[str, int]]:
    """Functions and methods as clang-format lays them out: their closing brace is indented like their first line."""
    lines = file.read_text(encoding="utf-8").splitlines()
    for opening, line in enumerate(lines):
        first = opening
        while lines[first].startswith("    ") and first > 0 and not re.search(r"[;{}]$|^$", lines[first - 1]):
            first -= 1
        head = re.match(r"( {0,2})(?!namespace|class|struct|enum|union|extern|//)\S", lines[first])
        if not line.endswith("{") or head is None or "(" not in "".join(lines[first : opening + 1]):
            continue
        for last in range(opening, len(lines)):
            if lines[last].startswith(head[1] + "}"):
                yield lines[first].strip(), last - first + 1
                break


def long_functions(sources: Iterator[Path]) -> list[str]:
    found = []
    for file in sources:
        for name, lines in (python_functions if file.suffix == ".py" else cpp_functions)(file):
            if lines > LONGEST:
                found.append(f"{file.relative_to(ROOT)}: {name} has {lines} lines")
    return found


def test_no_function_is_longer_than_a_page() -> None:
    folders = ("cpp", "python/bindings", "python/malus", "tests/cpp", "tests/python")
    files = [file for folder in folders for file in (ROOT / folder).rglob("*") if file.suffix in (".cpp", ".h", ".py")]
    assert len(files) > 500
    assert not long_functions(iter(files))


def test_long_functions_are_found(tmp_path: Path) -> None:
    body = "\n".join(["  work();"] * LONGEST)
    (tmp_path / "a.cpp").write_text(f"int short_one() {{\n  return 1;\n}}\nvoid long_one(\n    int a) {{\n{body}\n}}\n")
    assert [lines for _, lines in cpp_functions(tmp_path / "a.cpp")] == [3, LONGEST + 3]
    (tmp_path / "a.py").write_text("def long_one():\n" + body.replace(";", "") + "\n")
    assert list(python_functions(tmp_path / "a.py")) == [("long_one", LONGEST + 1)]


def python_imports(package: Path) -> dict[str, set[str]]:
    """Each module of a package with the modules of the package that it imports, anywhere in its file, except the packages
    that contain it."""
    files = {
        ".".join(file.relative_to(package.parent).with_suffix("").parts).removesuffix(".__init__"): file
        for file in package.rglob("*.py")
    }
    imports = {}
    for module, file in files.items():
        found = set()
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module is not None:
                of_module = {f"{node.module}.{alias.name}" for alias in node.names} & files.keys()
                found |= of_module or {node.module}
        imports[module] = {other for other in found & files.keys() if not module.startswith(f"{other}.")} - {module}
    return imports


def script_imports(folder: Path) -> dict[str, set[str]]:
    files = [file for file in folder.glob("*.js") if not file.name.endswith(".min.js")]
    return {file.name: set(re.findall(r"from '\./([\w.]+)'", file.read_text(encoding="utf-8"))) for file in files}


def circles(imports: dict[str, set[str]]) -> list[str]:
    """Modules that remain after those that import none of the others, or that none of the others imports, are removed repeatedly."""
    left = dict(imports)
    while True:
        inner = {name for name in left if imports[name] & left.keys() and any(name in imports[other] for other in left)}
        if inner == left.keys():
            return sorted(inner)
        left = {name: imports[name] for name in inner}


def test_modules_do_not_import_each_other_in_circles() -> None:
    modules, scripts = python_imports(ROOT / "python/malus"), script_imports(ROOT / "python/malus/studio/static")
    assert len(modules) > 100 and "malus.report" in modules["malus.result"]
    assert len(scripts) > 8 and "open_station.js" in scripts["draw.js"]
    assert not circles(modules)
    assert not circles(scripts)
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b", "d"}, "d": set()}) == ["b", "c"]


#: Sources that call OpenCV without an OpenCvThreads of their own, and why.
OPENCV_THREADS_OF_OTHERS = {
    "capture/contrast_band.cpp": "held by registration.cpp",
    "capture/registration_level.cpp": "held by registration.cpp",
    "evidence/reduced_view.cpp": "held by prior_alignment.cpp",
    "evidence/smoothing.cpp": "held by prior_alignment.cpp",
    "io/resection.cpp": "few points, on the calling thread",
    "object/nearest_points.cpp": "a search tree, asked on the context's threads",
    "photogrammetry/model_refinement.cpp": "a search tree, on the calling thread",
    "prior/smoothing_spline.cpp": "held by cloud_prior.cpp and raster_prior.cpp",
}


def test_opencv_takes_as_many_threads_as_the_context_says() -> None:
    folder = ROOT / "cpp/malus"
    without = set()
    for file in folder.rglob("*.cpp"):
        text = file.read_text(encoding="utf-8")
        if "#include <opencv2/" in text and not re.search(r"\bOpenCvThreads \w+\(", text):
            without.add(file.relative_to(folder).as_posix())
    assert without == OPENCV_THREADS_OF_OTHERS.keys()


def test_sources_use_no_views_of_ranges() -> None:
    """Debian 12's clang 14, which the fuzz targets need, cannot compile those of its standard library."""
    files = [file for file in (ROOT / "cpp").rglob("*") if file.suffix in (".cpp", ".h")]
    including = [file for file in files if "#include <ranges>" in file.read_text(encoding="utf-8")]
    assert not including


def test_units_of_the_studio_are_those_of_the_library() -> None:
    script = (ROOT / "python/malus/studio/static/api.js").read_text(encoding="utf-8")
    stated = re.search(r"METERS = \{(.*?)\}", script)
    assert stated is not None
    assert {name: float(size) for name, size in re.findall(r"(\w+): ([\d.e-]+)", stated[1])} == METERS


def test_files_listed_to_run_first_exist() -> None:
    assert all((ROOT / "tests/python" / name).exists() for name in LONGEST_FIRST)


def installed_headers() -> dict[str, Path]:
    folder = ROOT / "cpp"
    return {
        file.relative_to(folder).as_posix(): file
        for file in (folder / "malus").rglob("*.h")
        if not file.name.endswith("_internal.h")
    } | {"malus/core/version.h": folder / "malus/core/version.h.in"}


def test_installed_headers_are_few_and_stand_alone() -> None:
    """Decision 50. An installed header that includes one that is not installed breaks the build of every program that uses it."""
    installed = installed_headers()
    assert len(installed) <= MOST_INSTALLED_HEADERS
    for name, file in installed.items():
        included = re.findall(r'#include [<"](malus/[^>"]+)', file.read_text(encoding="utf-8"))
        assert set(included) <= installed.keys(), name


def declarations(header: str) -> list[str]:
    """Declarations of a C++ header, each in one line, without the bodies of functions."""
    header = re.sub(r'"(\\.|[^"\\\n])*"', '""', header)
    header = re.sub(r"//.*|/\*[\s\S]*?\*/|^ *#(.*\\\n)*.*", "", header, flags=re.MULTILINE)
    header = re.sub(
        r"\b(public|private|protected):|\b(alignas|decltype|explicit|noexcept|[A-Z_\d]{2,})\([^()]*\)", "", header
    )
    scope = re.compile(r"\s*(template\s*<[^()]*>\s*)?(inline\s+)?(namespace|class|struct|union|extern)\b[^()=]*")

    def without_braces(block: re.Match[str]) -> str:
        head, body = block.groups()
        if scope.fullmatch(head):
            return f";{body};"
        is_value_of_argument = head.count("(") > head.count(")")
        return head if is_value_of_argument else f"{head};"

    braces = 1
    while braces:
        header, braces = re.subn(r"(?:^|(?<=[;{]))([^;{}]*)\{([^{}]*)\}", without_braces, header)
    return [line for part in header.split(";") if (line := " ".join(part.split())) and not line.startswith(",")]


def argument_count(declaration: str) -> int:
    """Of a function; 0 for any other declaration."""
    declaration = re.sub(r"operator *(\(\)|[^\w\s(]+)", "operator", declaration)
    found = 1
    while found:
        declaration, found = re.subn(r"<[^<>]*>", "", declaration)
    listed = re.match(r"[^=(]*\(((?:[^()]|\([^()]*\))*)\)", declaration)
    return len(re.sub(r"\([^()]*\)", "", listed[1]).split(",")) if listed and listed[1].strip() else 0


def test_no_call_of_an_installed_header_has_more_than_four_arguments() -> None:
    """Decision 50. More are hard to tell apart where they are passed; they belong in a struct."""
    counts = {
        f"{name}: {declaration}": argument_count(declaration)
        for name, file in installed_headers().items()
        for declaration in declarations(file.read_text(encoding="utf-8"))
    }
    assert sum(count > 0 for count in counts.values()) > 100
    assert [call for call, count in counts.items() if count > 4] == []


def test_arguments_of_calls_are_counted() -> None:
    header = r"""
    #define MALUS_CALL(a, b) \
      call(a, b, 1, 2, 3)
    namespace malus {
    /// As f(1, 2, 3, 4, 5).
    template <class T>
    class Box : public Base<T, int> {
     public:
      explicit Box(int a, std::map<int, std::array<int, 2>> b = {}) : a_{a}, b_(b, 1, 2, 3, 4) { call(1, 2, 3, 4, 5); }
      T operator()(int u, int v) const { return [&](int x) { return f(u, v, x, 1, 2); }(3); }
      bool operator==(const Box&) const = default;
      MALUS_FIELDS(a, b, c, d, e)
     private:
      std::vector<int> a_{1, 2, 3, 4, 5};
    };
    enum class Kind { a, b, c, d, e };
    void none();
    inline const Box<int>& five(int a, double b = f(1, 2), const char* c = "f(,", Pose d = {1, 2},
                                std::function<int(int, int)> e = {}) noexcept(true);
    }
    """
    counts = {line: argument_count(line) for line in declarations(header)}
    assert [count for count in counts.values() if count] == [2, 2, 1, 5]
    assert max(counts, key=counts.__getitem__).startswith("inline const Box<int>& five(")


def test_the_debian_package_suggests_what_linking_the_library_needs() -> None:
    """Without one of these find_package(malus) fails. CLI11 and jemalloc are for malus-station only."""
    suggested = re.search(r'SUGGESTS\s+"([^"]+)"', (ROOT / "cmake/MalusPackage.cmake").read_text(encoding="utf-8"))
    setup = (ROOT / "scripts/setup.sh").read_text(encoding="utf-8")
    needed = set(re.findall(r"\blib[\w-]+-dev\b", setup)) - {"libcli11-dev", "libjemalloc-dev"}
    assert suggested is not None and set(suggested[1].split(", ")) == needed


def test_installed_headers_are_found_wherever_they_are_installed() -> None:
    install = (ROOT / "cmake/MalusInstall.cmake").read_text(encoding="utf-8")
    assert "INCLUDES DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}" in install
    assert "INSTALL_INTERFACE" not in (ROOT / "cpp/malus/CMakeLists.txt").read_text(encoding="utf-8")


def test_documents_say_how_many_headers_are_installed() -> None:
    decision = (ROOT / "docs" / "decisions" / "0050-public-surface.md").read_text(encoding="utf-8")
    assert f"{len(installed_headers())} headers" in decision


def test_an_environment_whose_making_was_interrupted_is_made_again(tmp_path: Path) -> None:
    """Its python is there, but no pip: every later call of scripts/demo ended with "No module named pip"."""
    folder = tmp_path / "with a space"
    made = folder / ".venv/bin"
    made.mkdir(parents=True)
    (folder / "scripts").mkdir()
    shutil.copy(ROOT / "scripts/setup.sh", folder / "scripts")
    (made / "python").symlink_to("/bin/true")
    calls = (
        'set -euo pipefail; source scripts/setup.sh; /usr/bin/python3() { echo called with "$@"; }; create_environment'
    )

    def said() -> str:
        return subprocess.run(["bash", "-c", calls], cwd=folder, capture_output=True, text=True, check=True).stdout

    assert "called with -m venv .venv" in said()
    (made / "pip").symlink_to("/bin/true")
    assert said() == ""


def test_every_file_of_the_package_makes_scripts_build_again() -> None:
    """A changed glossary was not installed: reports showed the old one."""
    listed = re.search(r"find (.+?) -type f", (ROOT / "scripts/setup.sh").read_text(encoding="utf-8"))
    install = (ROOT / "python/bindings/CMakeLists.txt").read_text(encoding="utf-8")
    installed = re.findall(r"\$\{PROJECT_SOURCE_DIR\}/(\S+?)/? DESTINATION", install)
    assert listed is not None and {"docs/glossary.md", "examples"} <= set(installed)
    assert {*installed, "README.md", "LICENSE", "pyproject.toml", "python", "cpp"} <= set(listed[1].split())


#: Spellings that are not American, anywhere in a word.
BRITISH = re.compile(
    "centre|neighbour|catalogue|colour|grey|behaviour|judgement|metre|polaris[ei]|labelled|modelled|favour|cancelled|licence|per cent\\b",
    re.I,
)
#: Exceptions: names from other projects, keys of existing files, and a key that is wrong on purpose.
FOREIGN = re.compile(
    r"aria-labelledby|colour-science|COLOURCHECKERS|CancelledError|\"CANCELLED\"|\"millimetre\"|\w*centres?_world"
    r"|world_centre_xy|sphere(?: = \{ |\.)centre|UNIT\[\"metre\""
)
#: Where the package colour-science is used, whose module is `colour`.
OF_COLOUR_SCIENCE = ("python/malus/chart.py", "tests/python/test_chart.py")


def tracked() -> list[Path]:
    """Text files of the repository without files from other projects."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode != 0:
        pytest.skip("this is no git repository")
    binary = (".png", ".ply", ".bin", ".tif", ".webp", ".jpg", ".woff2", ".ico", ".npz")
    files = [ROOT / name for name in listed.stdout.splitlines()]
    return [file for file in files if file.is_file() and file.suffix not in binary and ".min." not in file.name]


def test_words_are_spelled_the_american_way() -> None:
    found = []
    for file in tracked():
        name = file.relative_to(ROOT).as_posix()
        if file == Path(__file__) or name.startswith("LICENSE") or name in OF_COLOUR_SCIENCE:
            continue
        found += [
            f"{name}: {match[0]}" for match in BRITISH.finditer(FOREIGN.sub("", file.read_text(encoding="utf-8")))
        ]
    assert not found


def test_public_files_name_nothing_outside_the_repository() -> None:
    for folder in ("benchmarks", "python", "scripts", "docs", "examples"):
        for file in (file for file in tracked() if file.is_relative_to(ROOT / folder)):
            assert not re.search(r"\bshared/(data|tools)", file.read_text(encoding="utf-8")), file


@pytest.mark.skipif(shutil.which("g++") is None, reason="there is no compiler")
@pytest.mark.parametrize("sanitizer", ["address", "thread"])
def test_programs_under_sanitizers_start(tmp_path: Path, sanitizer: str) -> None:
    """The loader chooses between functions compiled for several processors before ThreadSanitizer has started; that once crashed."""
    source, program = tmp_path / "sum.cpp", tmp_path / "sum"
    source.write_text(
        '#include "malus/core/simd_internal.h"\n'
        "MALUS_SIMD_CLONES double sum(const double* v, int n) {\n"
        "  double s = 0;\n  for (int k = 0; k < n; ++k) s += v[k];\n  return s;\n}\n"
        "int main() { const double v[] = {1, 2, 3}; return static_cast<int>(sum(v, 3)) - 6; }\n"
    )
    flags = ("-std=c++20", "-O1", "-g1", f"-fsanitize={sanitizer}", f"-I{ROOT / 'cpp'}")
    subprocess.run(["g++", *flags, source, "-o", program], check=True)
    assert subprocess.run([program], check=False).returncode == 0


@pytest.mark.skipif(shutil.which("g++") is None, reason="there is no compiler")
def test_undefined_behavior_ends_programs_of_the_sanitize_preset(tmp_path: Path) -> None:
    """It was only printed, and a test that passes shows nothing of what was printed."""
    presets = json.loads((ROOT / "CMakePresets.json").read_text(encoding="utf-8"))["configurePresets"]
    [settings] = [preset["cacheVariables"] for preset in presets if preset["name"] == "sanitize"]
    source, program = tmp_path / "sum.cpp", tmp_path / "sum"
    source.write_text("int main(int count, char**) { int most = 2147483647; return (most += count) == 3; }\n")
    flags = [*settings.get("CMAKE_CXX_FLAGS", "").split(), f"-fsanitize={settings['MALUS_SANITIZE']}"]
    subprocess.run(["g++", *flags, source, "-o", program], check=True)
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode != 0 and "signed integer overflow" in done.stderr
