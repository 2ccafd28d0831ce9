"""Hands whose parts do not go together are refused in a line."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cadenza import CadenzaError, SceneConfig
from cadenza.hands.body import Actuator, Coupling
from cadenza.hands.shadow.hand import SHADOW
from cadenza.scene.scene import build_scene

BODY, THUMB = SHADOW.body, SHADOW.fingers[0]


def with_thumb(**changes: Any) -> Any:
    return (replace(THUMB, **changes), *SHADOW.fingers[1:])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"fingers": ()}, "has 0 fingers; give 1 to 8"),
        ({"fingers": (THUMB,) * 9}, "has 9 fingers; give 1 to 8"),
        ({"fingers": SHADOW.fingers[:4]}, r"reach.rest has shape \(5,\); give \(4,\)"),
        ({"reach": replace(SHADOW.reach, most=np.zeros(5))}, r"reach.most .* give \(5, 5\)"),
        ({"fingers": with_thumb(links=("thproximal", "x", "y"))}, "no link 'x'"),
        ({"fingers": with_thumb(links=("thproximal",), radii=(0.01,))}, "ff has 3 links and th 1"),
        ({"fingers": with_thumb(radii=(0.01,))}, "finger th: give a radius for each of its 3"),
        ({"start": {"FFJ9": 0.1}}, "start: there is no joint 'FFJ9'"),
        ({"servos": {}}, "servos has none for the actuator of 'WRJ2'"),
        ({"body": replace(BODY, links=BODY.links[1:])}, "the first link must be 'forearm'"),
        ({"body": replace(BODY, links=(*BODY.links[:2], BODY.links[3]))}, "'palm', its parent"),
        ({"body": replace(BODY, couplings=())}, "no joint or coupling 'FFJ0'"),
        (
            {"body": replace(BODY, couplings=(Coupling("FFJ0", ("FFJ9",), (0, 1)),))},
            "coupling FFJ0: there is no joint 'FFJ9'",
        ),
        (
            {"body": replace(BODY, actuators=(Actuator("TAIL", 1.0, 1.0),))},
            "no joint or coupling 'TAIL'",
        ),
    ],
)
def test_parts_that_do_not_go_together(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(CadenzaError, match=f"^hand shadow: .*{said}"):
        replace(SHADOW, **changes)


def test_what_the_physics_engine_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    heavy = tuple(replace(link, inertia=(1, 0, 0)) for link in BODY.links)
    hand = replace(SHADOW, body=replace(BODY, links=heavy))
    monkeypatch.setattr("cadenza.scene.scene.hand_named", lambda _: hand)
    with pytest.raises(CadenzaError, match=r"^hand shadow: MuJoCo cannot build it: [^\n]*inertia"):
        build_scene(SceneConfig())
