#!/usr/bin/env bash
# Asks the databases of known holes about every package of the lock that an installation can have, by hash.
# It needs the network, and what it finds changes from day to day: it is no part of the tests.
set -euo pipefail
cd "$(dirname "$0")/.."
UV=.tools/uv-$(sed -n 's/^uv==\([0-9.]*\).*/\1/p' deploy/uv.txt)/bin/uv
mkdir -p build
for extra in edge edge-gpu; do
    "$UV" export --frozen --quiet --no-dev --no-emit-project --extra "$extra" \
        --extra onboard --extra viewer --extra realsense --extra oak --extra ros2 --extra secure > "build/$extra.txt"
    "$UV" tool run --quiet pip-audit==2.9.0 --strict --disable-pip --require-hashes --requirement "build/$extra.txt"
done
