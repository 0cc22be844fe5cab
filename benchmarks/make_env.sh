#!/bin/sh
# Makes a separate environment for the baseline that cannot share HuePose's: opencv-contrib brings another OpenCV.
set -eu
cd "$(dirname "$0")/.."
folder=build/rivals
uv=$(command -v uv || find .tools -name uv -type f 2>/dev/null | head -n 1)
if [ -z "$uv" ]; then
    echo "make_env.sh: no uv found; run 'make setup' first." >&2
    exit 2
fi
"$uv" venv --python .venv/bin/python "$folder"
"$uv" pip install --python "$folder/bin/python" "opencv-contrib-python-headless==4.*" "numpy>=2.0"
"$folder/bin/python" -c "import cv2; cv2.ppf_match_3d"
echo "ready: $folder"
