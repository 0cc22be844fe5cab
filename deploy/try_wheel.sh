#!/usr/bin/env bash
# Builds sdist and wheel (from the sdist), and tests the wheel in an empty environment: the subscriber with the base
# installation, the parts of the demo with the extra `edge`.
set -euo pipefail
cd "$(dirname "$0")/.."
UV=$PWD/.tools/uv-$(sed -n 's/^uv==\([0-9.]*\).*/\1/p' deploy/uv.txt)/bin/uv
PYTHON=$PWD/.venv/bin/python
unset PYTHONPATH

rm -rf build/dist
"$UV" build --quiet --python "$PYTHON" --out-dir build/dist
wheel=$(echo "$PWD"/build/dist/*.whl)

try=$(mktemp -d)
trap 'rm -rf "$try"' EXIT
cd "$try"
# The locked versions, with hashes.
(cd "$OLDPWD" && "$UV" export --frozen --quiet --no-dev --no-emit-project) > base.txt
(cd "$OLDPWD" && "$UV" export --frozen --quiet --no-dev --no-emit-project --extra edge) > edge.txt
"$UV" venv --quiet --python "$PYTHON" env
install() { VIRTUAL_ENV=$try/env "$UV" pip install --quiet "$@"; }

install --require-hashes -r base.txt
install --no-deps "$wheel"
env/bin/huepose --version
env/bin/python -c "from huepose_protos import PoseClient; print('a subscriber works with the base installation')"

install --require-hashes -r edge.txt
env/bin/python - <<'END'
import importlib, pkgutil
import huepose, huepose_protos, huepose_services

assert all("/env/lib" in package.__file__ for package in (huepose, huepose_protos, huepose_services))
# Modules that need other extras.
others = ("huepose.training", "huepose_services.viewer", "huepose_services.authority")
names = [m.name for p in (huepose, huepose_services) for m in pkgutil.walk_packages(p.__path__, p.__name__ + ".")]
wanted = [name for name in names if not name.startswith(others)]
for name in wanted:
    importlib.import_module(name)
from huepose.scenes.shapes import demo_objects

assert len(demo_objects(0)) == 5
print(f"{len(wanted)} modules of the wheel can be imported, and the demo makes its objects")
END
env/bin/huepose demo --help > demo.txt
env/bin/huepose doctor > doctor.txt || { cat doctor.txt; exit 1; }
