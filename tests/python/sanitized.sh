#!/usr/bin/env bash
# Makes FOLDER/bin/python: the Python of .venv with all its packages, except that malus is the one with the instrumented
# extension, built in BUILD. This Python is linked with the sanitizers, so nothing need be preloaded: what it starts (COLMAP,
# browsers, Blender) runs without them, and what it starts by itself (`malus` as a program) runs with them.
#   sanitized.sh BUILD FOLDER
set -euo pipefail
build=$1 folder=$2
packages=$folder/$(.venv/bin/python -c 'import os, sys, sysconfig; print(os.path.relpath(sysconfig.get_path("purelib"), sys.prefix))')
rm -rf "$folder"
mkdir -p "$folder/bin" "$packages"
cp .venv/pyvenv.cfg "$folder"
.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))' > "$packages/others.pth"

cp -r python/malus "$packages"
cmake --install "$build" --component python --prefix "$packages" > /dev/null
printf '#!%s\nimport sys\nfrom malus.cli import main\nsys.exit(main())\n' "$folder/bin/python" > "$folder/bin/malus"
chmod +x "$folder/bin/malus"

# libstdc++ must be there when AddressSanitizer starts, or it does not find the function that throws exceptions.
read -ra flags <<< "$(/usr/bin/python3-config --includes) -Wl,--no-as-needed $(/usr/bin/python3-config --ldflags --embed)"
printf '#include <Python.h>\nint main(int argc, char** argv) { return Py_BytesMain(argc, argv); }\n' |
  g++ -fsanitize=address,undefined -x c++ - -o "$folder/bin/python" "${flags[@]}"
