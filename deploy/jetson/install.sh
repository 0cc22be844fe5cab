#!/usr/bin/env bash
# Installs HuePose as systemd services: a user, /opt/huepose, /etc/huepose/pipeline.yaml, units, udev rules.
#   sudo deploy/jetson/install.sh [--config PIPELINE] [--prefix DIR] [--extras LIST] [--no-start]
#   sudo deploy/jetson/install.sh --udev         only the rules for cameras
#   sudo deploy/jetson/install.sh --uninstall    units, rules and programs; configuration and data stay
# --dry-run prints what would be done and changes nothing. Run it again after a change of pipeline.yaml.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
repo=$(cd "$here/../.." && pwd)

config="" prefix=/opt/huepose extras="edge viewer realsense oak" user=huepose
dry=0 what=install start=1
units=/etc/systemd/system rules=/etc/udev/rules.d/70-huepose-cameras.rules home=/etc/huepose

fail() { printf 'install: %s\n' "$*" >&2; exit 2; }

while [ $# -gt 0 ]; do
    case $1 in
        --dry-run) dry=1 ;;
        --uninstall) what=uninstall ;;
        --udev) what=udev ;;
        --no-start) start=0 ;;
        --config | --prefix | --extras)
            [ $# -ge 2 ] || fail "$1 needs a value"
            declare "${1#--}=$2"
            shift ;;
        -h | --help) sed -n '2,6s/^# \{0,1\}//p' "$0"; exit 0 ;;
        *) fail "unknown option $1 (see --help)" ;;
    esac
    shift
done
case $prefix in /*) ;; *) fail "--prefix must be an absolute path, not $prefix" ;; esac
case $prefix in /home/* | /root/* | /tmp/*) fail "the services cannot see $prefix; choose a prefix such as /opt/huepose" ;; esac
[ -z "$config" ] || [ -f "$config" ] || fail "no configuration $config"
[ "$dry" = 1 ] || [ "$(id -u)" -eq 0 ] || fail "this needs root: run it with sudo, or look first with --dry-run"

run() {
    if [ "$dry" = 1 ]; then printf '  %s\n' "$*"; else "$@"; fi
}

# systemd may be installed without running, for example in a container.
systemd_runs() { [ "$dry" = 1 ] || [ -d /run/systemd/system ]; }

install_rules() {
    run install -m 644 "$here/70-huepose-cameras.rules" "$rules"
    if [ "$dry" = 1 ] || command -v udevadm >/dev/null; then
        run udevadm control --reload || true
        run udevadm trigger --action=add --subsystem-match=usb || true
    fi
}

make_user() {
    getent passwd "$user" >/dev/null \
        || run useradd --system --user-group --home-dir /var/lib/huepose --shell /usr/sbin/nologin "$user"
    local group
    for group in plugdev video render; do
        getent group "$group" >/dev/null && run usermod --append --groups "$group" "$user"
    done
    return 0
}

# The services cannot see /home and /root, so a Python that lies there does not do.
find_python() {
    local name
    for name in "${PYTHON:-}" python3.11 python3.12 python3.10 python3 /usr/bin/python3.{11,12,10}; do
        [ -n "$name" ] || continue
        "$name" -c 'import sys
assert (3, 10) <= sys.version_info[:2] <= (3, 12) and not sys.base_prefix.startswith(("/home/", "/root/"))
print(sys.executable)' 2>/dev/null && return
    done
    fail "no Python 3.10, 3.11 or 3.12 outside of /home and /root. Install one: apt-get install python3"
}

install_programs() {
    local python uv flags=() extra
    python=$(find_python)
    uv=$(ls -d "$repo"/.tools/uv-*/bin/uv 2>/dev/null | tail -1 || true)
    if [ -z "$uv" ]; then
        run "$python" -m pip install --quiet --target "$repo/.tools/uv-latest" uv
        uv=$repo/.tools/uv-latest/bin/uv
    fi
    for extra in $extras; do flags+=(--extra "$extra"); done
    run install -d -m 755 "$prefix"
    run env UV_PYTHON_DOWNLOADS=never UV_PROJECT_ENVIRONMENT="$prefix/.venv" "$uv" sync --quiet --frozen \
        --no-dev --no-editable --project "$repo" --python "$python" "${flags[@]}"
}

case $what in
udev)
    install_rules ;;
install)
    make_user
    install_programs
    run install -d -m 755 "$home"
    if [ -n "$config" ]; then
        run install -m 644 "$config" "$home/pipeline.yaml"
    elif [ ! -f "$home/pipeline.yaml" ]; then
        run install -m 644 "$repo/pipeline.yaml" "$home/pipeline.yaml"
    fi
    run "$prefix/.venv/bin/huepose" validate "$home/pipeline.yaml"
    run "$prefix/.venv/bin/huepose" units "$home/pipeline.yaml" --out "$units" --user "$user"
    install_rules
    if systemd_runs; then
        run systemctl daemon-reload
        [ "$start" = 0 ] || { run systemctl enable huepose.target; run systemctl restart huepose.target; }
    fi
    [ "$dry" = 1 ] || echo "installed: systemctl status 'huepose@*', journalctl -fu 'huepose@*', $prefix/.venv/bin/huepose status" ;;
uninstall)
    if systemd_runs; then
        run systemctl disable --now huepose.target || true
        run systemctl stop 'huepose@*.service' || true
    fi
    run rm -rf "$units/huepose.target" "$units/huepose@.service"
    for folder in "$units"/huepose@*.service.d; do
        [ -d "$folder" ] && run rm -rf "$folder"
    done
    run rm -f "$rules"
    run rm -rf "$prefix/.venv"
    if systemd_runs; then run systemctl daemon-reload; fi
    [ "$dry" = 1 ] || echo "removed; left: $home, /var/lib/huepose, /var/cache/huepose, user $user" ;;
esac
