#!/bin/sh
# Lints the JavaScript of the pages (gaitcal/report/page/scripts) by biome.json. For CI: nothing else here needs Node, and
# where it cannot be had the run goes on without, saying so.
set -eu
cd "$(dirname "$0")/../.."
tool=@biomejs/biome@2.6.8

if ! command -v npx >/dev/null 2>&1; then
    echo "lint_js.sh: no Node here; JavaScript is not linted." >&2
elif ! npx --yes "$tool" --version >/dev/null; then
    echo "lint_js.sh: $tool cannot be had; JavaScript is not linted." >&2
else
    exec npx --yes "$tool" lint --error-on-warnings
fi
