"""What a page holds of a performance, read by the page's own script."""

import json
from pathlib import Path

import numpy as np
import pytest
from made_up_episode import DT, make_episode

from cadenza.fingers import Finger
from cadenza.music.performance import played_in
from cadenza.music.score import Note, Score
from cadenza.report.html_pages import asset, write_page
from cadenza.report.performance_page import performance_page
from cadenza.scene.config import SceneConfig
from cadenza.scene.drawing import body_poses, drawing
from cadenza.scene.scene import build_scene
from headless import needs_chromium

pytestmark = needs_chromium
DATA = Path(__file__).parents[1] / "data"


def test_the_page_reads_what_was_recorded(browser, tmp_path):
    episode = make_episode()
    rng = np.random.default_rng(0)
    shape = (episode.num_steps, 88)
    goal, played = rng.random(shape) < 0.5, rng.random(shape) < 0.5
    key_press = rng.normal(0, 1e3, episode.num_steps)
    key_press[3] = np.nan
    episode.arrays.update(
        goal_keys=goal,
        key_activation=played,
        key_qpos=0.07 * rng.random(shape),
        hand_qpos=rng.normal(0, 1, (episode.num_steps, 2)),
        reward_key_press=key_press,
    )
    score = Score((Note(0.0, 10.0, 60, 50, Finger(1, 4)), Note(0.5, 10.0, 61, 90)))
    page = performance_page(episode, {}, {}, np.zeros((0, 2), np.int16), written=score)
    write_page(tmp_path / "page.html", page)
    browser.open(tmp_path / "page.html")
    browser.evaluate(f"(() => {{ {asset('recording.js')}; window.read = readRecording; }})()")
    read = json.loads(
        browser.evaluate("""read().then((found) => JSON.stringify({
            ...found,
            states: [...found.states],
            pedal: [...found.pedal],
            angles: [...found.angles],
            rewards: Object.entries(found.rewards).map(([name, values]) => [name, [...values]]),
            joints: [0, 1.25, 1.27, 99].map((time) => found.jointsAt(time + found.dt)),
        }))""")
    )
    notes = [(n["key"] + 21, n["from"], n["to"], n["velocity"]) for n in read["notes"]]
    assert notes == [(n.pitch, n.start, n.end, n.velocity) for n in played_in(episode).notes]
    assert read["written"] == [[0, 50], [0.5, 90]]
    assert read["fingers"] == [[39, 0, 1, 5]]
    assert all(abs(error) <= 200 for _, error in read["onsetErrors"])
    states = np.reshape(read["states"], shape)
    assert np.array_equal(states == 1, goal & played)
    assert np.array_equal(states == 2, ~goal & played)
    assert np.array_equal(states == 3, goal & ~played)
    assert set(read["pedal"]) == {0, 1, 2}
    angles = np.reshape(read["angles"], shape) / 255 * 0.07
    assert np.abs(angles - episode["key_qpos"]).max() < 0.07 / 255
    assert [name for name, _ in read["rewards"]] == ["total", "key_press", "energy"]
    expected = np.float32(episode["reward_key_press"])
    assert np.array_equal(np.array(dict(read["rewards"])["key_press"], "f4"), expected, True)
    at = np.array([0, 1.25, 1.27, 99]) / DT
    exact = [np.interp(at, np.arange(episode.num_steps), q) for q in episode["hand_qpos"].T]
    assert np.abs(np.array(read["joints"]) - np.transpose(exact)).max() < 5e-5


def test_bodies_are_where_the_simulation_has_them(browser, tmp_path):
    scene = build_scene(SceneConfig())
    qpos = np.random.default_rng(0).uniform(-1.5, 1.5, (5, len(scene.hand_joint_names)))
    scripts = asset("three.min.js") + asset("recording.js")
    (tmp_path / "hands.html").write_text(
        f"<script>{scripts}\nconst hands = createHands({json.dumps(drawing(scene)['skeleton'])});"
        f"window.cadenza = {{ ready: true, error: null }};</script>"
    )
    browser.open(tmp_path / "hands.html")
    for row, positions, quaternions in zip(qpos, *body_poses(scene, qpos), strict=True):
        state = browser.evaluate(f"""(() => {{
            hands.pose({row.tolist()});
            hands.root.updateMatrixWorld();
            return hands.bodies.map((body) => [
                ...body.getWorldPosition(new THREE.Vector3()),
                ...body.getWorldQuaternion(new THREE.Quaternion()),
            ]);
        }})()""")
        xpos, xyzw = np.split(np.array(state), [3], axis=1)
        assert np.abs(xpos - positions).max() < 2e-5
        same = np.abs(np.sum(np.roll(xyzw, 1, axis=1) * quaternions, axis=1))
        assert same == pytest.approx(1, abs=1e-6)
