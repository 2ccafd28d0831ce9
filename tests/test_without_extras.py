"""What needs no extra works where none is installed, as from the wheel alone."""

import subprocess
import sys

from cadenza.music.formats.midi import write_midi
from cadenza.music.score import Note, Score

PROGRAM = """
import sys
for name in (
    "PIL anyio dm_env flax huggingface_hub jax minari mujoco_warp optax pyarrow starlette "
    "symusic tensorboardX uvicorn warp websockets"
).split():
    sys.modules[name] = None  # importing it fails
from multiprocessing import get_context
from cadenza.cli import main
from cadenza.evaluation import processes
processes._SPAWN = get_context("fork")  # where nothing can be imported either
for words in (
    "bench --songs songs --agents zero -o bench",
    "dataset collect --songs songs --agent zero --episodes 1 -o demonstrations",
    "info songs/tune.mid",
    "play songs/tune.mid -o played",
    "film played -o tune.mp3",
    "arrange songs/tune.mid -o tune.musicxml",
    "practice songs/tune.mid --effort 0 -o practised",
    "results bench",
):
    main(words.split())
"""


def test_commands_run_without_extras(tmp_path):
    write_midi(Score((Note(0, 0.1, 60),)), tmp_path / "songs" / "tune.mid")
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
