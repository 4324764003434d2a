#!/bin/sh
# Everything CI checks: lint, format, types, import layers, tests. Arguments go to pytest.
#   sh scripts/test.sh                  the newest versions, in .venv
#   sh scripts/test.sh -m 'not slow'    the quick tests only
#   GAITCAL_LOWEST=1 sh scripts/test.sh two cases of each quick test on the lowest versions that pyproject.toml allows,
#                                       in .venv-lowest
# GAITCAL_EXTRAS=test,peers,cluster,docs,bones installs more, for the tests that need it.
set -eu
cd "$(dirname "$0")/.."
. scripts/venv.sh
# Commands that tests start find compiled modules, as those of a user do.
unset PYTHONDONTWRITEBYTECODE

if [ -n "${GAITCAL_LOWEST:-}" ]; then
    sed -n '/^dependencies = \[/,/^\]/s/^ *"\([A-Za-z0-9_-]*\)>=\([0-9.]*\).*/\1==\2/p' pyproject.toml >.venv-lowest.txt
    make_venv .venv-lowest test .venv-lowest.txt
    # Old versions warn of what newer ones changed: here that is no failure. Left out is what calls the same functions of
    # libraries as the rest: checks, drafts of studies, gait events, the pages of the documentation, validation scripts.
    # Cases and random examples are as many as show that a library works.
    exec "$venv_python" -m pytest -q -n auto --dist loadfile -W default --hypothesis-profile few --cases 2 \
        -m 'not slow and not peers and not browser' --ignore tests/docs --ignore tests/validation \
        --ignore tests/quality --ignore tests/intake --ignore tests/gait "$@"
fi

make_venv .venv "${GAITCAL_EXTRAS:-test}"
PATH="$PWD/.venv/bin:$PATH"
export PATH

failed=
check() {
    say "== $*"
    "$@" || failed="$failed $1${2:+ $2};"
}
# What another run of the same commit skipped are tests alone: it has checked the rest.
case " $*" in
*" --skipped-in="*) ;;
*)
    check ruff check .
    check ruff format --check .
    check mypy
    check lint-imports
    ;;
esac
# Whole files go to one process each, as their fixtures are made once a file; those with slow tests begin
# (tests/conftest.py), and what several files need is made once a run (tests/kept.py).
check pytest -n auto --dist loadfile "$@"
[ -z "$failed" ] || die "FAILED:$failed"
