#!/usr/bin/env bash
# Makes build/bundle/huepose-VERSION-ARCH-pyX.Y.tar for each target: wheels of HuePose and of all locked packages that
# it needs, uv, the installer and its files. It is installed without internet:
#   tar xf huepose-*.tar && sudo huepose-*/install.sh
#   deploy/bundle.sh [TARGET...]    a target is x86_64-3.10, aarch64-3.12 and so on (default: both of each)
#   EXTRAS="edge" deploy/bundle.sh  only these extras (default: edge viewer realsense oak ros2 secure)
set -euo pipefail
cd "$(dirname "$0")/.."
UV=$PWD/.tools/uv-$(sed -n 's/^uv==\([0-9.]*\).*/\1/p' deploy/uv.txt)/bin/uv
PYTHON=$PWD/.venv/bin/python
# The Python from which .venv was made has pip: `make setup` needs it.
PIP=("$("$PYTHON" -c 'import sys; print(sys._base_executable)')" -m pip)
OUT=$PWD/build/bundle
targets=("${@:-}")
[ -n "${targets[0]}" ] || targets=(x86_64-3.10 x86_64-3.12 aarch64-3.10 aarch64-3.12)
extras=${EXTRAS:-edge viewer realsense oak ros2 secure}
unset PYTHONPATH

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$UV" build --quiet --wheel --python "$PYTHON" --out-dir "$work/own"
wheel=$(basename "$work"/own/*.whl)
version=$(cut -d- -f2 <<< "$wheel")
flags=()
for extra in $extras; do flags+=(--extra "$extra"); done
"$UV" export --frozen --quiet --no-dev --no-emit-project "${flags[@]}" > "$work/locked.txt"

# The oldest supported system: all locked wheels fit Ubuntu 22.04 (JetPack 6), glibc 2.35.
glibc=35
for target in "${targets[@]}"; do
    arch=${target%-*} python=${target#*-}
    case $target in x86_64-3.1[0-2] | aarch64-3.1[0-2]) ;; *)
        echo "bundle: no target $target (x86_64 or aarch64, 3.10 to 3.12)" >&2; exit 2 ;;
    esac
    name=huepose-$version-$arch-py$python
    folder=$work/$name
    mkdir -p "$folder/wheels"
    # The locked packages that this target needs: environment markers of the target, not of this machine.
    "$UV" pip compile --quiet --no-deps --no-header --no-annotate --generate-hashes --only-binary :all: \
        --python-version "$python" --python-platform "$arch-manylinux_2_$glibc" \
        "$work/locked.txt" -o "$folder/requirements.txt"
    platforms=()
    for minor in $(seq $glibc -1 5); do platforms+=(--platform "manylinux_2_${minor}_$arch"); done
    platforms+=(--platform "manylinux2014_$arch" --platform "manylinux2010_$arch" --platform "manylinux1_$arch")
    fetch() {
        "${PIP[@]}" download --quiet --disable-pip-version-check --no-deps --only-binary :all: --require-hashes \
            --implementation cp --python-version "$python" "${platforms[@]}" "$@"
    }
    fetch -r "$folder/requirements.txt" -d "$folder/wheels"
    # uv, for the installer: it makes environments even if Python has no pip.
    fetch -r deploy/uv.txt -d "$work/uv-$arch"
    unzip -q -o -j "$work/uv-$arch"/uv-*.whl '*/scripts/uv' -d "$folder"
    chmod 755 "$folder/uv"
    cp "$work/own/$wheel" "$folder/wheels/"
    cp deploy/jetson/install.sh deploy/jetson/70-huepose-cameras.rules pipeline.yaml "$folder/"
    printf '%s\n' "$version" > "$folder/VERSION"
    printf '%s\n' "$python" > "$folder/PYTHON"
    # Check that the bundle is complete and fits the target.
    "$UV" pip install --quiet --dry-run --offline --no-index --find-links "$folder/wheels" --target "$work/none" \
        --python-version "$python" --python-platform "$arch-manylinux_2_$glibc" "huepose[${extras// /,}]==$version"
    mkdir -p "$OUT"
    tar -C "$work" -cf "$OUT/$name.tar" "$name"
    rm -rf "$folder"
    echo "$OUT/$name.tar: $(du -m "$OUT/$name.tar" | cut -f1) MB"
done
