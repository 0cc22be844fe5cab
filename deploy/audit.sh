#!/usr/bin/env bash
# Checks every locked package that an installation can have, by hash, against databases of known vulnerabilities.
# It needs the network, and its results change from day to day: it is not part of the tests.
set -euo pipefail
cd "$(dirname "$0")/.."
UV=.tools/uv-$(sed -n 's/^uv==\([0-9.]*\).*/\1/p' deploy/uv.txt)/bin/uv
mkdir -p build
for extra in edge edge-gpu; do
    "$UV" export --frozen --quiet --no-dev --no-emit-project --extra "$extra" \
        --extra onboard --extra viewer --extra realsense --extra oak --extra ros2 --extra secure > "build/$extra.txt"
    "$UV" tool run --quiet pip-audit==2.9.0 --strict --disable-pip --require-hashes --requirement "build/$extra.txt"
done
