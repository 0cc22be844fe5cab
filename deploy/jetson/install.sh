#!/usr/bin/env bash
# Installs HuePose as systemd services: a user, /opt/huepose, /etc/huepose/pipeline.yaml, units, udev rules.
# From the repository with the locked versions, or from a bundle of `make bundle` without internet. If HuePose is
# installed, it upgrades: the configuration is kept, and the previous version comes back if the new one is not ready in time.
#   sudo ./install.sh [--config PIPELINE] [--prefix DIR] [--extras LIST] [--no-start] [--ready-within SECONDS]
#   sudo ./install.sh --rollback     back to the previous version
#   sudo ./install.sh --udev         only the udev rules for cameras
#   sudo ./install.sh --uninstall    units, rules and programs; configuration and data stay
#   sudo ./install.sh --purge        these, configuration, data and the user
# --dry-run prints what would be done and changes nothing. Run the installer again after a change of pipeline.yaml.
set -euo pipefail
umask 022 # the services run as another user
here=$(cd "$(dirname "$0")" && pwd)
bundled=0
if [ -f "$here/VERSION" ]; then bundled=1 repo=$here; else repo=$(cd "$here/../.." && pwd); fi

# The first start compiles the kernels, which takes minutes on a small board.
config="" prefix=/opt/huepose extras="edge viewer realsense oak ros2 secure" user=huepose ready_within=900
dry=0 what=install start=1
units=/etc/systemd/system rules=/etc/udev/rules.d/70-huepose-cameras.rules home=/etc/huepose

fail() { printf 'install: %s\n' "$*" >&2; exit 2; }

while [ $# -gt 0 ]; do
    case $1 in
        --dry-run) dry=1 ;;
        --uninstall | --purge | --udev | --rollback) what=${1#--} ;;
        --no-start) start=0 ;;
        --config | --prefix | --extras | --ready-within)
            [ $# -ge 2 ] || fail "$1 needs a value"
            name=${1#--}
            declare "${name//-/_}=$2"
            shift ;;
        -h | --help) sed -n '2,11s/^# \{0,1\}//p' "$0"; exit 0 ;;
        *) fail "unknown option $1 (see --help)" ;;
    esac
    shift
done
case $prefix in /*) ;; *) fail "--prefix must be an absolute path, not $prefix" ;; esac
case $prefix in /home/* | /root/* | /tmp/*) fail "the services cannot see $prefix; choose a prefix such as /opt/huepose" ;; esac
case $ready_within in "" | *[!0-9]*) fail "--ready-within is a number of seconds, not $ready_within" ;; esac
[ -z "$config" ] || [ -f "$config" ] || fail "no configuration $config"
[ "$dry" = 1 ] || [ "$(id -u)" -eq 0 ] || fail "this needs root: run it with sudo, or try --dry-run first"

run() {
    if [ "$dry" = 1 ]; then printf '  %s\n' "$*"; else "$@"; fi
}

# systemd may be installed but not running, for example in a container.
systemd_runs() { [ "$dry" = 1 ] || [ -d /run/systemd/system ]; }

install_rules() {
    run install -D -m 644 "$here/70-huepose-cameras.rules" "$rules"
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

# The services cannot see /home and /root, so Python must be elsewhere. The wheels of a bundle fit one version.
find_python() {
    local name versions="3.11 3.12 3.10"
    [ ! -f "$here/PYTHON" ] || versions=$(cat "$here/PYTHON")
    for name in "${PYTHON:-}" $(printf 'python%s ' $versions) python3 $(printf '/usr/bin/python%s ' $versions); do
        [ -n "$name" ] || continue
        "$name" -c 'import sys
assert "%d.%d" % sys.version_info[:2] in sys.argv and not sys.base_prefix.startswith(("/home/", "/root/"))
print(sys.executable)' $versions 2>/dev/null && return
    done
    fail "no Python ${versions// / or } outside of /home and /root. Install one: apt-get install python3"
}

# Each version has its own folder, so that the previous one can come back; $prefix/.venv links to the one in use.
releases=$prefix/releases release=$prefix/releases/$(date -u +%Y%m%dT%H%M%S)
in_use() { if [ -L "$prefix/.venv" ]; then dirname "$(readlink "$prefix/.venv")"; fi; }

# With bytecode: the services may not write it, and would compile all imports at every start.
install_programs() {
    local python uv flags=() extra
    python=$(find_python)
    run install -d -m 755 "$release"
    if [ "$bundled" = 1 ]; then
        run env UV_PYTHON_DOWNLOADS=never "$here/uv" venv --quiet --offline --python "$python" "$release/.venv"
        install=(env VIRTUAL_ENV="$release/.venv" "$here/uv" pip install --quiet --compile-bytecode --offline --no-index --no-deps
                 --find-links "$here/wheels")
        run "${install[@]}" --require-hashes -r "$here/requirements.txt"
        run "${install[@]}" "$here"/wheels/huepose-*.whl
        return
    fi
    uv=$(ls -d "$repo"/.tools/uv-*/bin/uv 2>/dev/null | tail -1 || true)
    if [ -z "$uv" ]; then
        run "$python" -m pip install --quiet --target "$repo/.tools/uv-latest" uv
        uv=$repo/.tools/uv-latest/bin/uv
    fi
    for extra in $extras; do flags+=(--extra "$extra"); done
    run env UV_PYTHON_DOWNLOADS=never UV_PROJECT_ENVIRONMENT="$release/.venv" "$uv" sync --quiet --compile-bytecode --frozen \
        --no-dev --no-editable --project "$repo" --python "$python" "${flags[@]}"
}

# Activate a release: its units and the link to its programs. The units of the other release are removed only after
# the new ones exist.
use() {
    run rm -rf "$1/units"
    run "$1/.venv/bin/huepose" units "$home/pipeline.yaml" --out "$1/units" --user "$user" || {
        old_config
        fail "no units were made, so nothing that runs was changed"
    }
    remove_units
    run rm -rf "$prefix/.venv"
    run ln -s "$1/.venv" "$prefix/.venv"
    run cp -r "$1/units/." "$units"
    if systemd_runs; then
        run systemctl daemon-reload
        [ "$start" = 0 ] || {
            # A restart of the target alone would also restart workers that it does not name any more.
            run systemctl stop 'huepose@*.service' || true
            run systemctl reset-failed 'huepose@*' || true
            run systemctl enable huepose.target
            run systemctl restart --no-block huepose.target
        }
    fi
}

remove_units() {
    local folder
    run rm -rf "$units/huepose.target" "$units/huepose@.service"
    for folder in "$units"/huepose@*.service.d; do
        if [ -d "$folder" ]; then run rm -rf "$folder"; fi
    done
}

# Whether all workers are ready within the given time.
all_ready() {
    local worker end=$((SECONDS + ready_within))
    if [ "$dry" = 1 ] || [ "$start" = 0 ] || ! systemd_runs; then return 0; fi
    for worker in $(sed -n 's/^Wants=//p' "$units/huepose.target"); do
        until systemctl is-active --quiet "$worker"; do
            if [ $SECONDS -ge $end ]; then
                printf 'install: %s is not ready after %s s\n' "$worker" "$ready_within" >&2
                return 1
            fi
            sleep 1
        done
    done
}

# If the new version is rolled back, so is the configuration that was given with it.
old_config() {
    if [ -n "$config" ] && [ -f "$home/pipeline.yaml.before" ]; then
        run mv "$home/pipeline.yaml.before" "$home/pipeline.yaml"
    fi
}

# A version that did not come into use is not the one that --rollback means.
discard() {
    if [ "$dry" = 0 ] && [ "$(in_use)" != "$release" ]; then rm -rf "$release"; fi
}

# Remove old versions, except the previous one, for --rollback.
forget_but() {
    local old
    for old in "$releases"/*; do
        case $old in "$1" | "$2" | "$releases/*") ;; *) run rm -rf "$old" ;; esac
    done
}

stop() {
    if systemd_runs; then
        run systemctl disable --now huepose.target || true
        run systemctl stop 'huepose@*.service' || true
    fi
}

case $what in
udev)
    install_rules ;;
install)
    before=$(in_use)
    make_user
    trap discard EXIT
    install_programs
    run install -d -m 755 "$home"
    if [ -n "$config" ]; then
        if [ -f "$home/pipeline.yaml" ]; then run cp "$home/pipeline.yaml" "$home/pipeline.yaml.before"; fi
        run install -m 644 "$config" "$home/pipeline.yaml"
    elif [ ! -f "$home/pipeline.yaml" ]; then
        run install -m 644 "$repo/pipeline.yaml" "$home/pipeline.yaml"
    fi
    run "$release/.venv/bin/huepose" validate "$home/pipeline.yaml" || {
        old_config
        fail "the new version does not accept $home/pipeline.yaml${before:+; the installed version keeps running}"
    }
    use "$release"
    install_rules
    if ! all_ready; then
        [ -n "$before" ] || fail "see journalctl -u 'huepose@*'"
        old_config
        use "$before"
        fail "the previous version is back"
    fi
    forget_but "$release" "$before"
    [ "$dry" = 1 ] || echo "installed: systemctl status 'huepose@*', journalctl -fu 'huepose@*', $prefix/.venv/bin/huepose status" ;;
rollback)
    now=$(in_use) before=""
    for old in "$releases"/*; do
        if [ -d "$old" ] && [ "$old" != "$now" ]; then before=$old; fi
    done
    [ -n "$before" ] || fail "there is no previous version"
    run "$before/.venv/bin/huepose" validate "$home/pipeline.yaml" \
        || fail "the previous version does not accept $home/pipeline.yaml; the installed version keeps running"
    use "$before"
    all_ready || fail "see journalctl -u 'huepose@*'"
    echo "back to $before" ;;
uninstall | purge)
    stop
    remove_units
    run rm -f "$rules"
    run rm -rf "$prefix/.venv" "$releases"
    if systemd_runs; then run systemctl daemon-reload; fi
    if [ "$what" = purge ]; then
        run rm -rf "$home" /var/lib/huepose /var/cache/huepose /run/huepose
        if [ -d "$prefix" ]; then run rmdir --ignore-fail-on-non-empty "$prefix"; fi
        if getent passwd "$user" >/dev/null; then run userdel "$user"; fi
        [ "$dry" = 1 ] || echo "removed"
    else
        [ "$dry" = 1 ] || echo "removed; left: $home, /var/lib/huepose, /var/cache/huepose, user $user"
    fi ;;
esac
