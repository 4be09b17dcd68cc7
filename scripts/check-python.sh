#!/bin/sh
# Says what to do when PYTHON cannot make the virtual environment.
set -eu
python=$1

command -v "$python" > /dev/null || {
    echo "There is no $python. Install Python 3.11, or name yours: make PYTHON=/path/to/python3.11 ..." >&2
    exit 1
}
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
    echo "$("$python" --version) is too old, 3.11 is needed: make PYTHON=/path/to/python3.11 ..." >&2
    exit 1
}
"$python" -c 'import ensurepip, venv' 2> /dev/null || {
    echo "$python cannot make virtual environments. As root: apt-get install -y python3-venv" >&2
    exit 1
}
