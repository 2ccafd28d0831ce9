"""What Unix alone has is not needed to play, nor to look at what was trained."""

import os
import subprocess
import sys

PROGRAM = """
import os, sys
for name in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules[name] = None  # importing it fails, as on Windows
for name in (
    "O_NOFOLLOW O_CLOEXEC O_NONBLOCK getuid fork register_at_fork fchmod "
    "sched_getaffinity sched_setaffinity"
).split():
    if hasattr(os, name):
        delattr(os, name)
import importlib, pkgutil
import cadenza
for module in pkgutil.walk_packages(cadenza.__path__, "cadenza."):
    if ".assets" not in module.name and not module.name.endswith("__main__"):
        try:
            importlib.import_module(module.name)
        except ModuleNotFoundError as error:
            assert error.name.split(".")[0] != "cadenza" and error.name != "fcntl", error
        except cadenza.CadenzaError as error:  # of an extra that is not installed
            assert isinstance(error.__cause__, ModuleNotFoundError), error
from cadenza.learning.cpu_affinity import claimed_cores
from cadenza.learning.run_folder import RunFolder
from cadenza.cli import main
from pathlib import Path
with RunFolder(Path("run")).locked(), claimed_cores(1):
    pass
main(["play", "tune.mid", "--agent", "zero", "--no-video", "-o", "played"])
"""


def test_the_package_imports_and_plays_without_what_windows_lacks(tmp_path):
    from cadenza.music.formats.midi import write_midi
    from cadenza.music.score import Note, Score

    write_midi(Score((Note(0, 0.1, 60),)), tmp_path / "tune.mid")
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"JAX_PLATFORMS": "cpu"},
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "played" / "report.html").exists()
