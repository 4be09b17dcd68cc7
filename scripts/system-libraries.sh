#!/bin/sh
# Open3D and Skia come as wheels that load libraries of the system: installs those that are missing, or says how.
set -eu
python=$1
packages="libusb-1.0-0 libgl1 libegl1 libx11-6 libidn2-0 libexpat1"

if "$python" -c 'import open3d, skia' > /dev/null 2>&1; then
    exit 0
fi
if ! command -v apt-get > /dev/null; then
    echo "Open3D and Skia need system libraries; install what your system calls: $packages" >&2
    exit 1
fi
if [ "$(id -u)" -eq 0 ]; then
    as_root=""
elif sudo -n true 2> /dev/null; then
    as_root="sudo"
else
    echo "Open3D and Skia need system libraries. Run this line, then the same make again:" >&2
    echo "  sudo apt-get install -y $packages" >&2
    exit 1
fi
echo "Installing the system libraries of Open3D and Skia: $packages"
$as_root apt-get update --quiet=2
$as_root env DEBIAN_FRONTEND=noninteractive \
    apt-get install --quiet=2 --yes --no-install-recommends $packages > /dev/null
"$python" -c 'import open3d, skia'
