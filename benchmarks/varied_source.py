"""An instrumented copy of the C++ sources, in which an environment variable multiplies a constant (varied_constant.h).

`instrument(tree)` rewrites two kinds of numbers in the folders ROOMS: `constexpr` literals that the compiler does not need at compile time,
and the numbers without a name that NAMELESS lists. It returns which constants it varies and which it does not, and why. `build` makes
malus-station, and sweep_of_files.cpp beside it, from the copy.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from measuring import ROOT

ROOMS = ("prior", "stereo", "fusion")
NUMBERS = r"double|float|int|std::size_t|std::uint8_t"
DECLARATION = re.compile(rf"^( *)((?:inline |static )*)constexpr ({NUMBERS}) ([a-z_]\w* = [^;{{]*);", re.M)

# Constants that are not varied, by file:name or name, and why.
SPEED = "changes how the work is divided, not the result"
LAYOUT = "the compiler needs it: sizes of arrays and of the solver's blocks"
DERIVED = "follows from a formula"
NO_CHOICE = "no choice: a mark, the limit of a type, or part of a formula"
LEFT = {
    "outside": NO_CHOICE, "infinite": NO_CHOICE, "largest_code": NO_CHOICE, "usual_index": NO_CHOICE, "weighted_gaussian_variance": DERIVED,
    "refinement.cpp:half": NO_CHOICE, "delta": NO_CHOICE, "reflection_model.cpp:half": NO_CHOICE,
    "block_size": SPEED, "batch_size": SPEED, "bands_at_once": SPEED, "grain": SPEED, "band_rows": SPEED, "points_at_once": SPEED, "batch": SPEED,
    "strip_rows": SPEED, "chunk": SPEED, "few_offsets": SPEED, "tile_side": SPEED, "tile_side_of_few": SPEED, "surface_sweep.cpp:most": NO_CHOICE,
    "neighbor_search.cpp:bins": SPEED,
    "quad_px": LAYOUT, "quad_values": LAYOUT, "prior_block_px": LAYOUT, "node_count": LAYOUT, "bins": LAYOUT, "tries": LAYOUT, "cells": LAYOUT,
    "rays_u": LAYOUT, "tile_ring_px": LAYOUT, "rays_v": LAYOUT, "table_side": LAYOUT, "index_fit.cpp:parts": LAYOUT, "cell_px": LAYOUT, "window": LAYOUT,
}  # fmt: skip

# Numbers without a name in the code: file, the name that is used here, and the code with the numbers in « ».
NAMELESS = (
    ("fusion/surface_sigma.cpp", "of_noise", "prior.shares_windows ? 1.0 : «0.3»"),
    ("fusion/surface_sigma.cpp", "of_prior_metal", "metal_error > 0 ? «0.3»"),
    ("fusion/surface_sigma.cpp", "of_prior_mirrored", "mirrored ? «0.7»"),
    ("fusion/surface_sigma.cpp", "of_prior", ": «0.16»;"),
    ("fusion/surface_sigma.cpp", "of_changes", "changes(u, v) / «15»"),
    ("fusion/gain_by_scale.cpp", "of_pixels", "of_metal_ ? half : «0.25»"),
    (
        "fusion/refinement_weights.cpp",
        "likely_step",
        "std::clamp(3.3 * field.reflection.mirror.body_spread, «0.25», «0.5»)",
    ),
    ("fusion/refinement_weights.cpp", "of_body_spread", "std::clamp(«3.3» * field"),
    ("fusion/refinement_weights.cpp", "least_cos2", "std::max(cos2 / count, «0.02»)"),
    ("fusion/shading_fit.cpp", "robust_spread", "std::max(«1.5» * spread, 1e-12)"),
    ("fusion/diffuse_fit.cpp", "smoothness", "const double smoothness = «1e-4» *"),
    ("fusion/diffuse_fit.cpp", "roughnesses", "std::vector{«0.1», «0.15», «0.2», «0.25», «0.3», «0.4»}"),
    ("fusion/specular_fit.cpp", "around_peak", "std::abs(e - peak) < «0.2» * peak"),
    ("fusion/highlight_fit.cpp", "least_lobe_roughness", "std::log(«0.02»)"),
    ("fusion/highlight_fit.cpp", "largest_lobe_roughness", "std::log(«0.8»)"),
    ("fusion/reflection_labels.cpp", "mostly", "mostly_specular = specular > «0.5» * all"),
    ("fusion/surroundings_fit_internal.h", "intensity_error", "double intensity_error = «0.15»;"),
    ("fusion/surroundings.cpp", "least_hz", "std::max(hz, «0.2»)"),
    ("fusion/grid_optimization.cpp", "tolerance", "how.function_tolerance = «1e-4»;"),
    ("prior/choose_smoothing.cpp", "cell_of_spacing", "std::max(1.0, «0.6» * spacing_px)"),
    ("prior/choose_smoothing.cpp", "search_step", "round == 0 ? «0.7» : «0.35»"),
    ("prior/cloud_prior.cpp", "cell_of_length", "«0.7» * how.length_px"),
    ("prior/smoothed_cloud.cpp", "plane_rounds", "round < «8»; ++round"),
    ("prior/point_judgment.cpp", "one_sided", "direction.norm() < «0.6» *"),
    ("stereo/first_surface.cpp", "range_of_sigma", "std::max(«5» * quantile"),
    ("stereo/first_surface.cpp", "range_of_residuals", "«2» * quantile_in_place(residuals"),
    ("stereo/view_choice.cpp", "much_less_parallax", "parallax < «0.25» * least"),
    ("stereo/surface_sweep.cpp", "coarse_sweep", "constexpr std::array coarse_sweeps{Sweep{«0.5», «6», «1.0»}};"),
    (
        "stereo/surface_sweep.cpp",
        "finest_sweep",
        "constexpr std::array finest_sweeps{Sweep{«0.75», «2», «1.0»}, Sweep{«0.25», «2», «1.75»}};",
    ),
)
# Arrays of numbers; all numbers of an array are varied together.
ARRAYS = (("fusion/refine.cpp", "search_widenings"), ("fusion/surroundings_course.cpp", "any_roughness"))


@dataclass(frozen=True)
class Constant:
    """A number of the code: `file:name`, its value as written, and, if it is not varied, why."""

    key: str
    value: str
    left: str = ""


def split_at_commas(text: str) -> list[str]:
    parts, depth, start = [], 0, 0
    for i, letter in enumerate(text):
        depth += (letter in "({[") - (letter in ")}]")
        if letter == "," and depth == 0:
            parts.append(text[start:i])
            start = i + 1
    return [part.strip() for part in [*parts, text[start:]]]


def scope_of(text: str, at: int) -> str:
    """The kind of scope around a position in the text: "class", "namespace" or "function"."""
    depth = 0
    for i in range(at - 1, -1, -1):
        depth += (text[i] == "}") - (text[i] == "{")
        if depth < 0:
            head = re.split(r"[;{}]", re.sub(r"//.*", "", text[:i]))[-1]
            if re.search(r"\bnamespace\b", head):
                return "namespace"
            return "class" if re.search(r"\b(class|struct)\s+\w+[^()]*$", head) else "function"
    return "namespace"


def marked(file: str, name: str, code: str) -> tuple[str, str, list[tuple[str, str]]]:
    """Code of NAMELESS as it is in the file, the same code with varied numbers, and the keys and values of these numbers. The kinds of numbers
    of a sweep are varied separately, numbers of one kind together."""
    kinds = ("step", "offsets", "smoothing") if "Sweep{" in code else ("",)
    found: dict[str, list[str]] = {}

    def varied(match: re.Match[str]) -> str:
        kind = kinds[sum(map(len, found.values())) % len(kinds)]
        key = f"{file}:{name}" + (f"_{kind}" if kind else "")
        found.setdefault(key, []).append(match[1])
        value = match[1] if re.search(r"\D", match[1]) or kind == "offsets" or "round <" in code else match[1] + ".0"
        return f'MALUS_VARIED_VALUE("{key}", {value})'

    text = re.sub("«(.*?)»", varied, code)
    text = text.replace("constexpr std::array", "const std::array")
    return re.sub("[«»]", "", code), text, [(key, ", ".join(values)) for key, values in found.items()]


class Instrumented:
    """One source file: its constants, and its text with varied constants."""

    def __init__(self, path: Path, of_run_time: set[str]) -> None:
        self.name, self.text, self.constants = path.name, path.read_text(), list[Constant]()
        self.of_run_time = set(of_run_time)  # names that are no longer constant expressions
        self.room = path.parent.name
        self.counts: dict[str, int] = {}
        self.nameless()
        self.arrays()
        self.declarations()

    def key(self, name: str) -> str:
        """file:name; if a name occurs again, a number is appended from the second one on."""
        count = self.counts[name] = self.counts.get(name, 0) + 1
        return f"{self.name}:{name}" + (f".{count}" if count > 1 else "")

    def nameless(self) -> None:
        for file, name, code in NAMELESS:
            if file != f"{self.room}/{self.name}":
                continue
            plain, varied, numbers = marked(self.name, name, code)
            times = self.text.count(plain)
            if times == 1:
                self.text = self.text.replace(plain, varied)
            left = "" if times == 1 else f"its code was found {times} times: {plain}"
            self.constants += [Constant(key, value, left) for key, value in numbers]

    def arrays(self) -> None:
        for file, name in ARRAYS:
            match = re.search(rf"(static )?constexpr std::array {name}(\{{[^}}]*\}});", self.text)
            if file == f"{self.room}/{self.name}" and match:
                how = "static inline const" if match[1] and scope_of(self.text, match.start()) == "class" else "const"
                key = self.key(name)
                varied = f'{how} std::array {name} = malus_varied::of("{key}", std::array{match[2]});'
                self.text = self.text.replace(match[0], varied)
                self.constants.append(Constant(key, match[2].strip("{}")))

    def declarations(self) -> None:
        self.text = DECLARATION.sub(self.declaration, self.text)
        for check in re.findall(r"^ *static_assert\([^;]*\);\n", self.text, re.M):
            if self.of_run_time & set(re.findall(r"\w+", check)):
                self.text = self.text.replace(check, "")
        if any(not constant.left for constant in self.constants):
            start = self.text.index("#pragma once") + len("#pragma once") if "#pragma once" in self.text else 0
            self.text = self.text[:start] + '\n#include "malus/core/varied_constant.h"\n' + self.text[start:]

    def declaration(self, match: re.Match[str]) -> str:
        """Rewrite a declaration of one or several constants: those that are not varied stay constexpr, the others become run-time constants."""
        indent, how, kind, body = match.groups()
        text = match.string
        scope = scope_of(text, match.start())
        fixed, free = [], []
        for part in split_at_commas(body):
            name, value = (side.strip() for side in part.split("=", 1))
            words = set(re.findall(r"[A-Za-z_]\w*", re.sub(r"std::numbers::\w+|to_radians|\d[\w.]*", "", value)))
            key = self.key(name)
            left = LEFT.get(f"{self.name}:{name}", LEFT.get(name, ""))
            if "numeric_limits" in value:
                fixed.append(part)
            elif left:
                self.constants.append(Constant(key, value, left))
                fixed.append(part)
            elif not words and not re.search("[1-9]", value):
                self.constants.append(Constant(key, value, "is 0"))
                fixed.append(part)
            elif words & self.of_run_time:
                self.of_run_time.add(name)
                free.append(part)  # follows from varied constants
            elif words:
                fixed.append(part)
            else:
                self.of_run_time.add(name)
                self.constants.append(Constant(key, value))
                free.append(f'{name} = malus_varied::of<{kind}>("{key}", {value})')
        inline = "inline " in how
        of_class = "static inline const" if scope == "class" else "inline const" if inline else "const"
        run_time = "static const" if scope == "function" else of_class
        lines = [f"{indent}{how}constexpr {kind} {', '.join(fixed)};"] if fixed else []
        lines += [f"{indent}{run_time} {kind} {', '.join(free)};"] if free else []
        return "\n".join(lines)


def instrument(tree: Path) -> list[Constant]:
    """Rewrite the sources of ROOMS below tree/cpp; returns all constants that were found."""
    shutil.copyfile(ROOT / "benchmarks" / "varied_constant.h", tree / "cpp" / "malus" / "core" / "varied_constant.h")
    constants, headers = [], set[str]()
    for room in ROOMS:
        folder = tree / "cpp" / "malus" / room
        for path in [*sorted(folder.glob("*.h")), *sorted(folder.glob("*.cpp"))]:
            original = path.read_text()
            file = Instrumented(path, headers)
            constants += file.constants
            if path.suffix == ".h":
                headers |= file.of_run_time
            if file.text != original:
                path.write_text(file.text)
    return constants


def copy_sources(tree: Path) -> None:
    for name in ("cpp", "cmake"):
        shutil.copytree(ROOT / name, tree / name, dirs_exist_ok=True)
    for name in ("CMakeLists.txt", "LICENSE", "README.md"):
        shutil.copyfile(ROOT / name, tree / name)


def build(folder: Path, jobs: int) -> list[Constant]:
    """Copy, instrument and build below `folder`; unchanged files are not compiled again."""
    fresh, tree = folder / "fresh", folder / "tree"
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    copy_sources(fresh)
    constants = instrument(fresh)
    app = fresh / "cpp" / "app" / "CMakeLists.txt"
    shutil.copyfile(ROOT / "benchmarks" / "sweep_of_files.cpp", app.parent / "sweep_of_files.cpp")
    app.write_text(app.read_text() + SWEEP_OF_FILES)
    for path in (path for path in fresh.rglob("*") if path.is_file()):
        target = tree / path.relative_to(fresh)
        if not target.exists() or target.read_bytes() != path.read_bytes():
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
    shutil.rmtree(fresh)
    launcher = ["-DCMAKE_CXX_COMPILER_LAUNCHER=ccache"] if shutil.which("ccache") else []
    cmake = ["cmake", "-S", tree, "-B", folder / "build", "-G", "Ninja", "-DCMAKE_BUILD_TYPE=Release", *launcher]
    subprocess.run(list(map(str, cmake)), check=True)
    subprocess.run(
        ["ninja", "-C", str(folder / "build"), f"-j{jobs}", "-k0", "malus-station", "sweep-of-files"], check=True
    )
    return constants


SWEEP_OF_FILES = """
add_executable(sweep-of-files sweep_of_files.cpp)
target_link_libraries(sweep-of-files PRIVATE malus malus_settings)
set_target_properties(sweep-of-files PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR})
"""
