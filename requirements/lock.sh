#!/usr/bin/env bash
# Pins what gaitsweep needs, with hashes, one pair of files for each supported Python minor:
#   lock-3.X.txt      what a run needs, and the package's own build backend
#   lock-3.X-dev.txt  the same versions, and the tools of development and documentation
# Without an argument everything is renewed; with a package's name only that package is.
set -euo pipefail
cd "$(dirname "$0")/.."
bin=.venv/bin
"$bin/python" -m uv --version >/dev/null 2>&1 || "$bin/python" -m pip install --quiet uv

if [ $# -gt 0 ]; then renew=(--upgrade-package "$1"); else renew=(--upgrade); fi
for minor in 3.11 3.12 3.13; do
    options=(--python-version "$minor" --python-platform x86_64-manylinux_2_28 --generate-hashes --quiet
        --no-emit-index-url --no-emit-find-links --custom-compile-command "make lock" --group build)
    runtime=requirements/lock-$minor.txt
    "$bin/python" -m uv pip compile pyproject.toml "${options[@]}" "${renew[@]}" -o "$runtime"
    "$bin/python" -m uv pip compile pyproject.toml "${options[@]}" "${renew[@]}" --group dev \
        --constraints "$runtime" -o "requirements/lock-$minor-dev.txt"
    echo "Pinned $(grep -c '^[a-z].*==' "$runtime") packages for a run under Python $minor."
done
