#!/bin/sh
# The embedded example, end to end: installs gaitcal into .venv and runs it. Arguments go to `gaitcal demo`.
set -eu
cd "$(dirname "$0")/.."
. scripts/venv.sh
make_venv .venv ""
exec .venv/bin/gaitcal demo --out demo-output "$@"
