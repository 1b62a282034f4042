# Sourced by the other scripts: installs everything that a bare Debian 12 lacks, and skips what is up to date.
#   apt packages → .venv (Python package malus) → build/ (malus-station)
# A script that sets with_tests=ON also gets the C++ tests and the tools of the Python tests.

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
cd "$root"

with_tests=OFF
packages=(
  g++ cmake ninja-build ccache pkg-config git
  libeigen3-dev libtbb-dev libsuitesparse-dev libopenblas-dev libceres-dev libopencv-dev libtiff-dev libpng-dev libjpeg-dev libssl-dev libre2-dev
  libjemalloc-dev
  colmap
  libtomlplusplus-dev nlohmann-json3-dev libcli11-dev
  python3 python3-dev python3-venv
)

say() { printf '\n== %s\n' "$*"; }

install_packages() {
  local missing=() package
  for package in "${packages[@]}"; do
    dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing+=("$package")
  done
  [ ${#missing[@]} -eq 0 ] && return
  say "installing Debian packages: ${missing[*]}"
  local sudo=()
  [ "$(id -u)" -eq 0 ] || sudo=(sudo)
  "${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get update -q
  "${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends "${missing[@]}"
}

create_environment() {
  [ -x .venv/bin/pip ] && return  # the last file that is made: without it, an earlier call was interrupted here
  say "creating the virtual environment .venv"
  /usr/bin/python3 -m venv .venv
}

# One hash of all files that the build depends on, so that an unchanged tree is neither configured nor built again.
source_state() {
  find CMakeLists.txt cmake cpp python tests/cpp examples docs/glossary.md pyproject.toml README.md LICENSE -type f -not -name '*.pyc' -print0 |
    LC_ALL=C sort -z | xargs -0 sha256sum | sha256sum | cut -d' ' -f1
}

# The packages that Malus needs, with those of the Python tests if the tests are built.
required_packages() {
  .venv/bin/python - $with_tests <<'END'
import re, sys, tomllib
with open("pyproject.toml", "rb") as file:
    project = tomllib.load(file)["project"]
extras, wanted = project["optional-dependencies"], list(project["dependencies"])
if sys.argv[1] == "ON":
    wanted += extras["test"]
for package in wanted:  # which grows by the packages of the extras that it names
    if own := re.fullmatch(r"malus\[(.*)\]", package):
        wanted += [other for name in own[1].split(",") for other in extras[name]]
    else:
        print(package)
END
}

# One CMake tree, build/, serves all scripts: scikit-build-core builds the extension in it, together with malus-station and
# the C++ tests, and installs the Python part into .venv. A tree that was once built with tests is always built with tests.
build() {
  local built state what="malus-station, Python package" tests=""
  built=$(cat .venv/malus-source-state 2>/dev/null || true)
  [[ $built == "tests "* ]] && with_tests=ON
  [ "$with_tests" = ON ] && what+=", tests" tests="tests "
  state="$tests$(source_state)"
  [ "$built" = "$state" ] && [ -x build/malus-station ] && return
  say "building ($what)"
  .venv/bin/python -m pip install -q --disable-pip-version-check "scikit-build-core>=0.10" "pybind11>=2.12"
  local settings=(build-dir=build cmake.define.MALUS_BUILD_APP=ON cmake.define.MALUS_BUILD_TESTS=$with_tests
                  cmake.define.MALUS_WERROR=ON cmake.define.CMAKE_CXX_COMPILER_LAUNCHER=ccache)
  # The packages that Malus and its Python tests need are installed while the compiler runs. They are built, if they have no wheel, with
  # the tools that they require, and Malus with those in .venv.
  required_packages | .venv/bin/python -m pip install -q --disable-pip-version-check -r /dev/stdin & local others=$!
  CMAKE_GENERATOR=Ninja .venv/bin/python -m pip install -q --disable-pip-version-check --no-build-isolation --no-deps \
    "${settings[@]/#/--config-settings=}" .
  wait $others
  echo "$state" > .venv/malus-source-state
}

setup() {
  install_packages
  create_environment
  build
}
