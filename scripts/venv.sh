# Sourced, not run: makes the project's virtual environment. POSIX sh.
#
#   . scripts/venv.sh
#   make_venv FOLDER EXTRAS [CONSTRAINTS]
#
# FOLDER is relative to the project's root, where the caller stands. EXTRAS is a comma-separated list, or empty.
# Afterwards $venv_python is the environment's interpreter. A stamp in FOLDER, keyed on pyproject.toml, makes the
# second call quick; a folder that was moved, half made or has lost its interpreter is made anew.
# uv is used when it is on the PATH. PYTHON names another interpreter than python3.

say() { printf '%s\n' "$*" >&2; }

die() { say "$*"; exit 1; }

supported_python() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 10))' 2>/dev/null; }

# pip of the environment; where Debian left out ensurepip, the pip of the system works on the environment.
venv_pip() {
    if "$venv_python" -m pip --version >/dev/null 2>&1; then
        "$venv_python" -m pip "$@"
    else
        "$base_python" -m pip --python "$venv_python" "$@"
    fi
}

find_python() {
    base_python=${PYTHON:-python3}
    command -v "$base_python" >/dev/null 2>&1 || die "gaitcal needs Python 3.10 or newer; '$base_python' is not on the PATH."
    supported_python "$base_python" ||
        die "gaitcal needs Python 3.10 or newer; '$base_python' is $("$base_python" -V 2>&1). Name another one: PYTHON=python3.12 sh $0"
}

make_venv() {
    venv=$1 extras=$2 constraints=${3:-}
    venv_python=$venv/bin/python
    key="$PWD $(cksum <pyproject.toml) $constraints"
    if [ -z "$extras" ]; then
        set -- "$venv"/.gaitcal-stamp-* # an environment with more in it serves as well
    else
        set -- "$venv/.gaitcal-stamp-$extras"
    fi
    for stamp; do
        if [ "$(cat "$stamp" 2>/dev/null)" = "$key" ] && supported_python "$venv_python"; then
            return 0
        fi
    done

    command -v uv >/dev/null 2>&1 && uv=yes || uv=
    [ -n "$uv" ] || find_python
    say "Installing gaitcal into $venv (the first time this takes a minute or two) ..."
    if [ "$(cat "$venv/.gaitcal-root" 2>/dev/null)" != "$PWD" ] || ! supported_python "$venv_python"; then
        rm -rf "$venv"
    fi
    rm -f "$venv"/.gaitcal-stamp-*
    target=.${extras:+[$extras]}
    if [ -n "$uv" ]; then
        [ -d "$venv" ] || uv venv --quiet --python "${PYTHON:->=3.10}" "$venv" || die "uv could not make $venv."
        uv pip install --quiet --python "$venv_python" ${constraints:+--constraint "$constraints"} --editable "$target" ||
            die "The installation into $venv failed; the messages above say why."
    else
        if ! [ -d "$venv" ]; then
            "$base_python" -m venv "$venv" >/dev/null 2>&1 || {
                rm -rf "$venv"
                "$base_python" -m venv --without-pip "$venv" || die "'$base_python -m venv' failed."
            }
        fi
        venv_pip install --quiet --disable-pip-version-check ${constraints:+--constraint "$constraints"} --editable "$target" ||
            die "The installation into $venv failed; the messages above say why."
    fi
    printf '%s' "$PWD" >"$venv/.gaitcal-root"
    printf '%s' "$key" >"$venv/.gaitcal-stamp-$extras"
}
