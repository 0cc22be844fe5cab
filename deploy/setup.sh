#!/usr/bin/env bash
# Makes .venv with `edge`, `onboard`, `viewer`, `ros2`, `secure`, `docs`, both cameras and `dev`. It needs only Python, pip and apt.
# Idempotent: a second call with nothing to do takes about a second.
set -euo pipefail
cd "$(dirname "$0")/.."

UV_VERSION=$(sed -n 's/^uv==\([0-9.]*\).*/\1/p' deploy/uv.txt)
UV=.tools/uv-$UV_VERSION

fail() { printf 'setup: %s\n' "$*" >&2; exit 2; }

# Candidates are run, not only looked up: a launcher with that name may exist and fail.
find_python() {
    for name in "${PYTHON:-}" python3.11 python3.12 python3.10 python3; do
        [ -n "$name" ] || continue
        path=$("$name" -c 'import sys; assert (3,10) <= sys.version_info[:2] <= (3,12); print(sys.executable)' 2>/dev/null) \
            && { printf '%s\n' "$path"; return; }
    done
    fail "no Python 3.10, 3.11 or 3.12 found (looked for \$PYTHON, python3.11, python3.12, python3.10, python3). Install one, for example: apt-get install python3"
}

# Shared libraries that the wheels expect from the system.
system_libraries() {
    local missing=() row known
    # On Debian, ldconfig is in a folder that is not on a normal user's PATH.
    known=$(PATH=$PATH:/usr/sbin:/sbin ldconfig -p)
    for row in libusb-1.0.so.0:libusb-1.0-0 libudev.so.1:libudev1 libGL.so.1:libgl1 libEGL.so.1:libegl1 \
               libX11.so.6:libx11-6 libidn2.so.0:libidn2-0 libgomp.so.1:libgomp1; do
        [[ $known == *"${row%%:*}"* ]] || missing+=("${row##*:}")
    done
    if [ "$(uname -m)" = aarch64 ]; then
        [[ $known == *libgfortran.so.5* ]] || missing+=(libgfortran5)
    fi
    [ ${#missing[@]} -eq 0 ] && return
    if [ "$(id -u)" -eq 0 ] && command -v apt-get >/dev/null; then
        echo "setup: installing system libraries: ${missing[*]}"
        DEBIAN_FRONTEND=noninteractive apt-get install -y -qq "${missing[@]}" >/dev/null 2>&1 \
            || { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq "${missing[@]}" >/dev/null; }
    else
        fail "system libraries are missing. Run: sudo apt-get install ${missing[*]}"
    fi
}

system_libraries
python=$(find_python)
if [ ! -x "$UV/bin/uv" ]; then
    echo "setup: downloading uv $UV_VERSION"
    PIP_ROOT_USER_ACTION=ignore "$python" -m pip install --quiet --disable-pip-version-check --target "$UV" --no-deps --only-binary :all: \
        --require-hashes -r deploy/uv.txt \
        || fail "pip could not download uv $UV_VERSION: is the package index reachable?"
fi
[ -e .venv/.compiled ] || echo "setup: installing packages into .venv, 2.5 GB on disk (packages in the cache of pip or uv are not downloaded again)"
export UV_PYTHON_DOWNLOADS=never
# Like pip, use the system's certificate store: it has the certificate of a company's proxy.
[ ! -e /etc/ssl/certs/ca-certificates.crt ] || export UV_SYSTEM_CERTS="${UV_SYSTEM_CERTS:-true}"
"$UV/bin/uv" sync --frozen --quiet --python "$python" \
    --extra edge --extra onboard --extra viewer --extra realsense --extra oak --extra secure --extra ros2 --extra docs --group dev
