#!/usr/bin/env bash
# Makes .venv and installs gaitsweep into it: install.sh runtime|dev. Called by the Makefile.
# The versions are the locked ones where this Python and system have a lock file.
set -euo pipefail
cd "$(dirname "$0")/.."
kind=$1

works() { # a pyenv shim may stand on the PATH for a Python that is not there: only running it tells
    "$1" -c 'import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1
}

if ! { [ -x .venv/bin/python ] && works .venv/bin/python && .venv/bin/python -m pip --version >/dev/null 2>&1; }; then
    found=
    for candidate in ${PYTHON:-python3.13 python3.12 python3.11 python3 python}; do
        if works "$candidate"; then found=$candidate && break; fi
    done
    if [ -z "$found" ]; then
        echo "gaitsweep needs Python 3.11 or newer with venv and pip, and none of" \
            "${PYTHON:-python3.13, python3.12, python3.11, python3} is that:" \
            "install one (on Debian also its python3-venv), or say where it is: make PYTHON=/path/to/python3.12 ..." >&2
        exit 1
    fi
    rm -rf .venv
    echo "Making .venv with $("$found" --version) ..."
    "$found" -m venv .venv
fi

minor=$(.venv/bin/python -c 'import sys; print("%d.%d" % sys.version_info[:2])')
lock=requirements/lock-$minor.txt
if [ "$kind" = dev ]; then lock=requirements/lock-$minor-dev.txt; fi
pip() { .venv/bin/python -m pip --disable-pip-version-check -qq "$@"; }

if [ -f "$lock" ] && [ "$(uname -s)" = Linux ]; then
    echo "Installing the $(grep -c '^[A-Za-z0-9].*==' "$lock") packages of $lock (a minute or two the first time) ..."
    # The lock is complete, so pip need not resolve anything.
    pip install --no-deps --no-compile --only-binary :all: --require-hashes -r "$lock"
    # pip would compile on one core, and the packages' own tests too.
    .venv/bin/python -m compileall -q -j 0 -x '/(tests?|testing|pip|setuptools|OpenGL)/' .venv/lib >/dev/null 2>&1 || true
    pip install --no-deps --no-build-isolation --editable .
else
    echo "There is no lock file for Python $minor on $(uname -s): installing the newest versions that fit," \
        "which are not the tested ones."
    pip install --upgrade pip
    groups=()
    if [ "$kind" = dev ]; then groups=(--group dev); fi
    pip install --editable . ${groups[@]+"${groups[@]}"}
fi
