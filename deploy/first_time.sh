#!/usr/bin/env bash
# What a computer does once with the .venv of deploy/setup.sh: compiles the kernels, learns the built-in objects and
# draws their scene. Does nothing where it is done.
set -euo pipefail
cd "$(dirname "$0")/.."

# Compiled for the code as it is: again where a file of it is newer.
if [ ! -e .venv/.compiled ] || [ -n "$(find huepose services -name '*.py' -newer .venv/.compiled -print -quit)" ]; then
    echo "setup: compiling, learning the built-in objects and drawing their scene: three to five minutes of a processor, once for each computer and version"
    .venv/bin/python -m huepose_services.first_time
    touch .venv/.compiled
fi
if [ ! -e .venv/.welcomed ]; then
    touch .venv/.welcomed
    cat <<'NEXT'
setup: done. `huepose` is .venv/bin/huepose; put it on your path for this shell with: source .venv/bin/activate
  huepose demo                        run the whole pipeline on a built-in scene and measure its accuracy
  huepose new tea_box examples/tea_box.obj   start with your own object: reference model, test frame, pipeline.yaml
NEXT
fi
