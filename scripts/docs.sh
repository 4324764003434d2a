#!/bin/sh
# The API reference: HTML in docs/api from the docstrings. Ends with an error on a warning. Arguments: another folder.
set -eu
cd "$(dirname "$0")/.."
. scripts/venv.sh
make_venv .venv-docs docs
exec "$venv_python" -W error scripts/api_reference.py "$@"
