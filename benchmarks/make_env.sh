#!/bin/sh
# Environments of their own for rivals that cannot live beside HuePose.
# Usage: benchmarks/make_env.sh [rivals|dora] [FOLDER]
#   rivals  (default)  opencv-contrib, which brings another OpenCV; into build/rivals
#   dora               dora-rs with its command line; into build/dora
set -eu
cd "$(dirname "$0")/.."
what=${1:-rivals}
folder=${2:-build/$what}
case $what in
    rivals) packages="opencv-contrib-python-headless==4.*"; check="import cv2; cv2.ppf_match_3d" ;;
    dora) packages="dora-rs==1.* dora-rs-cli==1.* pyarrow"; check="import dora, pyarrow" ;;
    *) echo "make_env.sh: '$what' is no environment; rivals and dora are." >&2; exit 2 ;;
esac
uv=$(command -v uv || find .tools -name uv -type f 2>/dev/null | head -n 1)
if [ -z "$uv" ]; then
    echo "make_env.sh: no uv found; run 'make setup' first." >&2
    exit 2
fi
"$uv" venv --python .venv/bin/python "$folder"
# shellcheck disable=SC2086  # several packages
"$uv" pip install --python "$folder/bin/python" $packages "numpy>=2.0"
"$folder/bin/python" -c "$check"
echo "ready: $folder"
