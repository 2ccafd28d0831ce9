"""How much of a song hands could hold at most."""

import sys

import mujoco
import numpy as np

from benchmarks import limits
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene


def test_no_hand_gets_there_before_one_that_need_not_stop():
    """In MuJoCo, with the control at the end of its range all the way."""
    scene = build_scene(SceneConfig(hands="right"))
    least = dict(zip(limits.WAYS.round(3).tolist(), limits.least_seconds(scene), strict=True))
    assert sorted(least.values()) == list(least.values())
    model = scene.model
    place = model.joint("rh_forearm_tx").qposadr[0]
    servo = model.actuator("rh_A_forearm_tx").id
    low, high = model.actuator_ctrlrange[servo]
    for way in (0.05, 0.1, 0.2, 0.4):
        fastest = np.inf
        for start in np.linspace(low, high - way, 9, endpoint=False):
            data = mujoco.MjData(model)
            data.qpos[place], data.ctrl[servo] = start, high
            while data.qpos[place] < start + way and data.time < 1.0:
                mujoco.mj_step(model, data)
            fastest = min(fastest, data.time)
        assert fastest < least[way] < 2 * fastest


def test_faster_jumps_and_better_fingers_hold_more(monkeypatch, capsys):
    command = ["limits", "debug", "--first-seconds", "6", "--fingerings", "3"]
    monkeypatch.setattr(sys, "argv", command)
    limits.main()
    rows = capsys.readouterr().out.splitlines()[2:]
    f1 = np.array([[float(cell) for cell in row.split("|")[2:4]] for row in rows])
    assert f1.shape == (3, 2)
    assert (np.diff(f1, axis=0) >= 0).all()
    assert (np.diff(f1, axis=1) >= 0).all()
    assert (f1 > 0.9).all()
    assert (f1 <= 1).all()
