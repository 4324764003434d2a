#!/bin/sh
# The documentation site, from docs/ and the program itself: HTML in site/VERSION, to be opened as files or put on any
# server; site/index.html leads to the newest, site/versions.json lists those that are there. Ends with an error on a
# warning (a link that leads nowhere is one), and on something that no page explains. Arguments: another folder for site/.
set -eu
cd "$(dirname "$0")/.."
. scripts/venv.sh
make_venv .venv-docs docs
site=${1:-site}
version=$(sed -n 's/^version = "\(.*\)"$/\1/p' pyproject.toml)
NO_MKDOCS_2_WARNING=1 "$venv_python" -m mkdocs build --strict --quiet --site-dir "$(mkdir -p "$site" && cd "$site" && pwd)/$version"
"$venv_python" -m scripts.tools.documentation --site "$site/$version" --index
echo "documentation: $site/$version/index.html"
