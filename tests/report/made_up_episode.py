"""A made-up performance: two simple hands that walk along a full keyboard."""

import numpy as np

from cadenza.episode import Episode

STEPS, DT = 40, 0.05
FINGERS = 5


# Thumb to little finger.
COLOURS = [(0.9, 0.1, 0.1), (0.9, 0.6, 0.1), (0.1, 0.7, 0.1), (0.1, 0.4, 0.9), (0.6, 0.1, 0.9)]
UPRIGHT, ALONG_X = [1, 0, 0, 0], [0.7071068, 0, 0.7071068, 0]


def _keys() -> list[dict]:
    keys, white = [], 0
    for key in range(88):
        black = (key + 9) % 12 in (1, 3, 6, 8, 10)
        pos = [-0.03 if black else 0, -0.6 + 0.0235 * white, 0.026 if black else 0.01125]
        pos[1] -= 0.01175 * black
        white += not black
        size = [0.045, 0.005, 0.009] if black else [0.075, 0.01125, 0.01125]
        hinge = [pos[0] - size[0], pos[1], pos[2]]
        shape = {"pos": pos, "size": size, "hinge": hinge, "axis": [0, 1, 0]}
        keys.append(shape | {"travel": 0.07, "black": black})
    return keys


def _geom(body: int, kind: str, size: list, pos: list, quat: list, finger: int | None) -> dict:
    drawn = {"body": body, "type": kind, "size": size, "pos": pos, "quat": quat}
    colour = (0.8, 0.8, 0.82) if finger is None else COLOURS[finger % FINGERS]
    return drawn | {"rgba": [*colour, 1], "finger": finger}


def _hand(number: int) -> list[dict]:
    """A forearm with a palm (the hand's body 0) and five fingers (its bodies 1..5)."""
    first = number * (1 + FINGERS)
    return [
        _geom(first, "cylinder", [0.05, 0.09], [0.3, 0, 0.06], ALONG_X, None),
        _geom(first, "box", [0.05, 0.045, 0.012], [0.12, 0, 0.05], UPRIGHT, None),
        *(
            _geom(first + 1 + i, "capsule", [0.008, 0.03], [0, 0, 0], ALONG_X, number * FINGERS + i)
            for i in range(FINGERS)
        ),
    ]


def _bodies(number: int) -> list[dict]:
    """A forearm that slides along the keyboard, and fingers fixed to it."""
    slide = {"type": "slide", "axis": [0, 1, 0], "index": number}
    forearm = {"parent": -1, "pos": [0, 0, 0], "quat": UPRIGHT, "joints": [slide]}
    fixed = {"parent": number * (1 + FINGERS), "quat": UPRIGHT, "joints": []}
    fingers = [{"pos": [0.04, 0.022 * (i - 2), 0.035], **fixed} for i in range(FINGERS)]
    return [forearm, *fingers]


def make_episode(steps: int = STEPS, hands: int = 2, song: str = "A made-up walk") -> Episode:
    time = np.arange(steps)
    middle = np.array([0.12, -0.17])[:hands] + 0.05 * np.sin(time / 12)[:, None]  # (T, hands)
    bodies = hands * (1 + FINGERS)

    goal, played = np.zeros((steps, 88), bool), np.zeros((steps, 88), bool)
    goal[0:20, 39], goal[20:, 43] = True, True
    played[4:20, 39], played[25:30, 50] = True, True
    reward = np.sin(time / 5)
    arrays = {
        "action": np.zeros((steps, 3)),
        "goal_keys": goal,
        "goal_fingers": np.full((steps, 88), -1, np.int8),
        "goal_sustain": time % 10 < 5,
        "key_qpos": 0.07 * played,
        "key_activation": played,
        "sustain_activation": time % 10 < 6,
        "hand_qpos": middle,
        "reward_total": 1 + reward,
        "reward_key_press": reward,
        "reward_energy": np.full(steps, -0.1),
    }
    scene = {
        "bodies": [f"body {i}" for i in range(bodies)],
        "skeleton": [body for hand in range(hands) for body in _bodies(hand)],
        "geoms": [geom for hand in range(hands) for geom in _hand(hand)],
        "shells": [],
        "keys": _keys(),
    }
    return Episode(song, DT, arrays, scene)
