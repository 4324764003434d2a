#!/bin/sh
# Fetches axe-core, which finds what keeps people from using a page, and prints the path of its script: GAITCAL_AXE of
# tests/report/page/test_accessible.py. It is no part of this repository; where it cannot be had those tests are skipped.
set -eu
version=4.14.1
folder=${XDG_CACHE_HOME:-$HOME/.cache}/gaitcal/axe-core-$version

if [ ! -f "$folder/package/axe.min.js" ]; then
    if ! command -v npm >/dev/null 2>&1; then
        echo "fetch_axe.sh: no Node here." >&2
        exit 1
    fi
    mkdir -p "$folder"
    archive=$(npm pack --silent --pack-destination "$folder" "axe-core@$version") || {
        echo "fetch_axe.sh: axe-core@$version cannot be had." >&2
        exit 1
    }
    tar -xzf "$folder/$archive" -C "$folder" package/axe.min.js package/LICENSE
fi
echo "$folder/package/axe.min.js"
