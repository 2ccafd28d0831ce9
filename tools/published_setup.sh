#!/usr/bin/env bash
# Makes a virtual environment with the published RoboPianist (PyPI 1.0.10), apart from cadenza's:
#
#     tools/published_setup.sh VENV_DIR
#
# The package has no upper bounds and does not run on what pip would pick (numpy 2, pandas 2.3);
# SciPy and scikit-learn are held at versions made for numpy 1. pyaudio is built from source, so a
# C compiler and portaudio's headers have to be there, and FluidSynth's library. On Debian, Ubuntu:
#
#     apt-get install -y gcc portaudio19-dev fluidsynth
#
# PYTHON names the interpreter to use, python3.11 otherwise. Takes a minute and 1.2 GB.
set -euo pipefail

fail() {
    echo "published_setup: $*" >&2
    exit 1
}

[ $# -eq 1 ] || fail "usage: $0 VENV_DIR"
venv=$1
python=${PYTHON:-python3.11}

"$python" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null ||
    fail "$python is not Python 3.11; set PYTHON to one"
echo '#include <portaudio.h>' | cc -E - >/dev/null 2>&1 ||
    fail "a C compiler or portaudio.h is missing: apt-get install -y gcc portaudio19-dev"
"$python" -c 'import ctypes.util, sys; sys.exit(not ctypes.util.find_library("fluidsynth"))' ||
    fail "FluidSynth's library is missing: apt-get install -y fluidsynth"

log=$(mktemp)
trap 'rm -f "$log"' EXIT
"$python" -m venv "$venv" >"$log" 2>&1 || fail "cannot make $venv: $(tail -n 1 "$log")"
"$venv/bin/pip" install robopianist==1.0.10 mujoco==3.17.0 "numpy<2" "pandas<2.3" "scipy<1.14" \
    "scikit-learn<1.6" gymnasium dm_env_wrappers >"$log" 2>&1 ||
    fail "pip could not install it: $(grep -m 1 '^ERROR' "$log" || tail -n 1 "$log")"
MUJOCO_GL=off "$venv/bin/python" -c 'from robopianist import suite' >"$log" 2>&1 ||
    fail "installed, but it does not import: $(tail -n 1 "$log")"
echo "published RoboPianist is in $venv; run scripts with $venv/bin/python"
