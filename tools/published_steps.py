"""Steps the published RoboPianist environment and prints how many control steps a second it makes.

Runs with the interpreter of the environment that `tools/published_setup.sh` builds, never with
cadenza's own:

    VENV/bin/python tools/published_steps.py --song CMajorScaleTwoHands --seconds 20
    VENV/bin/python tools/published_steps.py --episode episode_d.npz --seconds 20

The task is the paper's: lookahead 10, gravity compensation, capsule fingertips, and the wrappers
of its training script that shape a step (one observation vector, actions in [-1, 1], float32).
Song, action space and trimming come from the episode where there is one. One JSON line on stdout:
`steps`, `seconds`, `steps_per_second`, and with an episode `max_key_deviation` [rad], the largest
distance of a key angle to the recorded one over a pass before the clock starts.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
import warnings
from pathlib import Path

# Before the packages are imported: nothing is drawn here, and stderr stays readable.
os.environ.setdefault("MUJOCO_GL", "off")
warnings.filterwarnings("ignore")

import numpy as np  # noqa: E402


def make_env(song: str, reduced_action_space: bool, trim_silence: bool, seed: int):
    """The published two-hand environment on one of its built-in songs, wrapped."""
    from dm_env_wrappers import (
        CanonicalSpecWrapper,
        ConcatObservationWrapper,
        SinglePrecisionWrapper,
    )
    from robopianist import suite

    name = f"RoboPianist-debug-{song}-v0"
    if name not in suite.DEBUG:
        songs = ", ".join(known.split("-")[2] for known in suite.DEBUG)
        raise ValueError(f"not a built-in song; choose one of {songs}")
    env = suite.load(
        name,
        seed=seed,
        task_kwargs={
            "n_steps_lookahead": 10,
            "trim_silence": trim_silence,
            "gravity_compensation": True,
            "primitive_fingertip_collisions": True,
            "reduced_action_space": reduced_action_space,
            "change_color_on_activation": True,
        },
    )
    return SinglePrecisionWrapper(CanonicalSpecWrapper(ConcatObservationWrapper(env), clip=True))


def key_angles(env) -> np.ndarray:
    """Joint angles of the 88 keys, bass to treble, (88,) [rad]."""
    return np.array(env.physics.bind(env.task.piano.joints).qpos)


def replay(env, episode, seconds: float) -> tuple[int, float, float]:
    """Plays the recorded actions over and over; (steps, seconds, largest key deviation [rad])."""
    low, high = episode["action_min"], episode["action_max"]
    actions = 2.0 * (episode["action"] - low) / (high - low) - 1.0
    recorded = episode["key_qpos"]

    deviation = 0.0
    env.reset()
    for action, expected in zip(actions, recorded, strict=True):
        env.step(action)
        deviation = max(deviation, float(np.abs(key_angles(env) - expected).max()))

    steps, start = 0, time.perf_counter()
    while time.perf_counter() - start < seconds:
        env.reset()
        for action in actions:
            last = env.step(action).last()
            steps += 1
            if last or time.perf_counter() - start >= seconds:
                break
    return steps, time.perf_counter() - start, deviation


def play_noise(env, seconds: float, seed: int) -> tuple[int, float]:
    """Uniform random actions, a fresh episode at each end; (steps, seconds)."""
    rng = np.random.default_rng(seed)
    size = env.action_spec().shape
    env.reset()
    steps, start = 0, time.perf_counter()
    while time.perf_counter() - start < seconds:
        if env.step(rng.uniform(-1.0, 1.0, size)).last():
            env.reset()
        steps += 1
    return steps, time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description="Control steps a second of published RoboPianist.")
    parser.add_argument("--song", default="CMajorScaleTwoHands", help="name of a built-in song")
    parser.add_argument("--episode", type=Path, help="recorded episode (.npz) to replay")
    parser.add_argument("--seconds", type=float, default=10.0, help="how long to step [s]")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random actions")
    args = parser.parse_args()

    try:
        if args.episode:
            with np.load(args.episode, allow_pickle=False) as file:
                episode = {name: file[name] for name in file.files}
            options = (bool(episode["reduced_action_space"]), bool(episode["trim_silence"]))
            env = make_env(str(episode["song"]), *options, seed=args.seed)
        else:
            env = make_env(args.song, True, True, seed=args.seed)
    except ImportError as error:
        sys.exit(f"{error}: run this with the interpreter that tools/published_setup.sh installed")
    except (OSError, KeyError, ValueError) as error:
        sys.exit(f"{args.episode or args.song}: {error}")

    if args.episode:
        steps, elapsed, deviation = replay(env, episode, args.seconds)
        extra = {"max_key_deviation": deviation}
    else:
        steps, elapsed = play_noise(env, args.seconds, args.seed)
        extra = {}
    rate = {"steps": steps, "seconds": elapsed, "steps_per_second": steps / elapsed}
    print(json.dumps(rate | extra))


if __name__ == "__main__":
    main()
