#!/usr/bin/env bash
# Run once on each computer after deploy/setup.sh: compiles the kernels, onboards the built-in objects and renders
# their scene. Does nothing if this is done.
set -euo pipefail
cd "$(dirname "$0")/.."

# Compile again if a source file is newer.
if [ ! -e .venv/.compiled ] || [ -n "$(find huepose services -name '*.py' -newer .venv/.compiled -print -quit)" ]; then
    echo "setup: compiling, onboarding the built-in objects and rendering their scene: three to five minutes of CPU time, once for each computer and version"
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
