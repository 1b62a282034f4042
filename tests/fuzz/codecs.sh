#!/usr/bin/env bash
# Builds Debian's versions of libtiff, libpng and libjpeg with the fuzz targets' instrumentation, into FOLDER/lib and
# FOLDER/include. The libraries that they use (zlib, libwebp, ...) are the system's, without instrumentation.
#   codecs.sh FOLDER
set -euo pipefail
mkdir -p "$1/source"
prefix=$(cd "$1" && pwd)
cd "$prefix/source"

sources=$PWD/debian.sources
cat > "$sources" << SOURCES
Types: deb-src
URIs: http://deb.debian.org/debian
Suites: bookworm
Components: main
Signed-By: /usr/share/keyrings/debian-archive-keyring.gpg
SOURCES
# Separate package lists, so that the machine's own lists stay unchanged.
mkdir -p lists/partial cache/archives/partial
apt=(-q -o Dir::Etc::sourcelist="$sources" -o Dir::Etc::sourceparts=- -o Dir::State::lists="$PWD/lists" -o Dir::Cache="$PWD/cache"
     -o APT::Sandbox::User="")
apt-get "${apt[@]}" update
for package in libjpeg-turbo libpng1.6 tiff; do
  compgen -G "$package-*/CMakeLists.txt" > /dev/null || apt-get "${apt[@]}" source "$package"
done

flags="-O1 -g1 -fsanitize=fuzzer-no-link,address,undefined"
build() {
  cmake -G Ninja -S "$1" -B "build-$1" -DCMAKE_C_COMPILER=clang-14 -DCMAKE_C_COMPILER_LAUNCHER=ccache \
    -DCMAKE_BUILD_TYPE=RelWithDebInfo -DCMAKE_C_FLAGS="$flags" -DCMAKE_C_FLAGS_RELWITHDEBINFO= \
    -DCMAKE_INSTALL_PREFIX="$prefix" -DCMAKE_INSTALL_LIBDIR="$prefix/lib" -DCMAKE_PREFIX_PATH="$prefix" -DCMAKE_INSTALL_RPATH="$prefix/lib" \
    "${@:2}" > /dev/null
  cmake --build "build-$1" --target install > "build-$1.log" 2>&1 || { tail -20 "build-$1.log"; return 1; }
}
# Assembly code cannot be instrumented, so libjpeg is built from its C code.
build "$(basename libjpeg-turbo-*/)" -DWITH_SIMD=OFF -DENABLE_STATIC=OFF -DWITH_TURBOJPEG=OFF
build "$(basename libpng1.6-*/)" -DPNG_STATIC=OFF -DPNG_TESTS=OFF -DPNG_EXECUTABLES=OFF
build "$(basename tiff-*/)" -Dtiff-tools=OFF -Dtiff-tests=OFF -Dtiff-contrib=OFF -Dtiff-docs=OFF -Dcxx=OFF
