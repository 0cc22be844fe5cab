#!/usr/bin/env bash
# systemd's score of each worker's sandbox: 0 is closed, 10 is open. Needs no running systemd.
#   deploy/security.sh [PIPELINE]
set -euo pipefail
cd "$(dirname "$0")/.."
config=${1:-pipeline.yaml}
units=$(mktemp -d)
trap 'rm -rf "$units"' EXIT
.venv/bin/huepose units "$config" --out "$units" --user "$(id -un)" > /dev/null
printf '| worker | exposure |\n|---|---|\n'
for unit in $(sed -n 's/^Wants=//p' "$units/huepose.target"); do
    # systemd finds an instance by a link to its template in the same folder.
    ln -s huepose@.service "$units/$unit"
    score=$(SYSTEMD_UNIT_PATH=$units: systemd-analyze security --offline=true --no-pager "$units/$unit" \
        | sed -n 's/.*Overall exposure level for .*: \([0-9.]*\) .*/\1/p')
    worker=${unit#huepose@}
    printf '| %s | %s |\n' "${worker%.service}" "${score:?systemd-analyze gave no score for $unit}"
done
