#!/usr/bin/env bash
# Tests a bundle in a Debian container with systemd as process 1 and without network: install, reload of the
# configuration, killed worker, upgrade, upgrade to a version that never gets ready (it is rolled back), rollback by
# hand, and uninstall, after which nothing is left. Needs root, mmdebstrap and systemd-nspawn; without them it exits
# with 77.
#   deploy/try_bundle.sh build/bundle/huepose-VERSION-x86_64-py3.11.tar [FOLDER]
# FOLDER keeps the Debian for the next run. CACHE=~/.cache/huepose: spares the first computations of the built-in scene.
set -euo pipefail
bundle=$(realpath "${1:?which bundle?}")
[ "$(id -u)" -eq 0 ] || { echo "try_bundle: this needs root" >&2; exit 77; }
for tool in mmdebstrap systemd-nspawn; do
    command -v $tool >/dev/null || { echo "try_bundle: no $tool (apt-get install mmdebstrap systemd-container)" >&2; exit 77; }
done
work=${2:-$(mktemp -d)}
base=$work/base root=$work/root machine=huepose-try-$$
mkdir -p "$work"
[ -d "$base" ] || mmdebstrap --quiet --variant=apt --include=systemd,dbus,python3,procps,passwd bookworm "$base"
rm -rf "$root"
cp -a "$base" "$root"

say() { printf '%s  %s\n' "$(date +%T)" "$*"; }
inside() { nsenter -t "$leader" -m -u -i -n -p -C -- env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin "$@"; }
must() { "$@" || { say "NO: $*"; inside journalctl --no-pager -n 40 || true; exit 1; }; }
finish() {
    inside systemctl poweroff 2>/dev/null || true
    for _ in $(seq 20); do kill -0 "$nspawn" 2>/dev/null || break; sleep 0.5; done
    kill "$nspawn" 2>/dev/null || true
    rm -rf "$root"
    [ -n "${kept:-}" ] || rm -rf "$work"
}
kept=${2:-}

mkdir -p "$root/root/new" "$root/root/broken" "$root/var/cache/huepose/huepose"
tar -C "$root/root/new" --strip-components=1 -xf "$bundle"
cp -a "$root/root/new/." "$root/root/broken/"
# A broken version, whose workers fail at start: a package is missing.
sed -i '/^opencv-python-headless/,/[^\\]$/d' "$root/root/broken/requirements.txt"
printf 'camera: {source: synthetic}\n' > "$root/root/pipeline.yaml"
[ -z "${CACHE:-}" ] || cp -a "$CACHE/." "$root/var/cache/huepose/huepose/"

systemd-nspawn -q -D "$root" -M $machine --register=no --keep-unit -b --console=read-only \
    --system-call-filter=@memlock --private-network > "$work/console.txt" 2>&1 &
nspawn=$!
trap finish EXIT
leader=""
for _ in $(seq 60); do
    leader=$(pgrep -P "$nspawn" | head -1 || true)
    [ -n "$leader" ] && inside systemctl is-system-running 2>/dev/null | grep -qE 'running|degraded' && break
    sleep 0.5
done
[ -n "$leader" ] || { say "NO: it does not boot"; exit 1; }
must inside test ! -e /sys/class/net/eth0
say "booted, without a network"

within=${READY_WITHIN:-900}
workers='camera tracker reinit detector segmenter estimator'
active() { for w in $workers; do inside systemctl is-active --quiet "huepose@$w" || return 1; done; }
pid() { inside systemctl show -p MainPID --value "huepose@$1"; }

must inside /root/new/install.sh --config /root/pipeline.yaml --ready-within "$within"
must active
first=$(inside readlink /opt/huepose/.venv)
say "installed; all workers are ready"
must inside setpriv --reuid=huepose --regid=huepose --clear-groups env HUEPOSE_RUN=/run/huepose /opt/huepose/.venv/bin/huepose status

old=$(pid tracker)
inside sh -c 'echo "tracker: {max_age_ms: 250, history_frames: 30}" >> /etc/huepose/pipeline.yaml'
must inside systemctl reload 'huepose@*'
said() { inside journalctl --no-pager -u huepose@tracker | grep -qF "$1"; }
for _ in $(seq 30); do said 'max_age_ms (300.0 > 250.0)' && break; sleep 1; done
must said 'max_age_ms (300.0 > 250.0)'
must said 'changes that wait for the next start: tracker.history_frames (20 > 30)'
must active
must test "$(pid tracker)" = "$old"
say "reloaded: changes were applied if possible, the others were named"

inside kill -9 "$old"
for _ in $(seq "$within"); do [ "$(pid tracker)" != "$old" ] && active && break; sleep 1; done
must active
must test "$(pid tracker)" != "$old"
say "the tracker was killed and is ready again"

inside sh -c 'echo "# mine" >> /etc/huepose/pipeline.yaml'
sleep 1
must inside /root/new/install.sh --ready-within "$within"
second=$(inside readlink /opt/huepose/.venv)
must test "$first" != "$second"
must inside grep -q '^# mine' /etc/huepose/pipeline.yaml
must active
say "upgraded; the configuration stayed"

sleep 1
if inside /root/broken/install.sh --ready-within "${BROKEN_WITHIN:-60}"; then say "NO: a broken version was installed"; exit 1; fi
must test "$(inside readlink /opt/huepose/.venv)" = "$second"
for _ in $(seq "$within"); do active && break; sleep 1; done
must active
say "a version that did not get ready was rolled back"

must inside /root/new/install.sh --rollback --ready-within "$within"
must test "$(inside readlink /opt/huepose/.venv)" = "$first"
must active
say "rolled back by hand"

must inside /root/new/install.sh --purge
left=$(inside find / -xdev \( -path /root -o -path /proc -o -path /sys -o -path /var/log -o -path /var/lib/dpkg \) -prune -o -iname '*huepose*' -print)
must test -z "$left"
must test -z "$(inside pgrep -f 'huepose run' || true)"
must test -z "$(inside getent passwd huepose || true)"
say "uninstalled; nothing is left"
