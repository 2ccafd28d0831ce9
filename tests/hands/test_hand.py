"""Hands whose parts do not go together are refused with a clear line."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cadenza import CadenzaError, SceneConfig
from cadenza.hands.body import Actuator, Body, Coupling, Geom
from cadenza.hands.servo import Servo
from cadenza.hands.shadow import SHADOW
from cadenza.scene.scene import build_scene

BODY, THUMB = SHADOW.body, SHADOW.fingers[0]


def with_thumb(**changes: Any) -> Any:
    return (replace(THUMB, **changes), *SHADOW.fingers[1:])


def with_palm(**changes: Any) -> Body:
    change = {"palm": changes}
    return replace(BODY, links=tuple(replace(i, **change.get(i.name, {})) for i in BODY.links))


def with_joint(joint: str, **changes: Any) -> Body:
    links = tuple(
        replace(link, joint=replace(link.joint, **changes))
        if link.joint and link.joint.name == joint
        else link
        for link in BODY.links
    )
    return replace(BODY, links=links)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"fingers": ()}, "has 0 fingers; give 1 to 8"),
        ({"fingers": (THUMB,) * 9}, "has 9 fingers; give 1 to 8"),
        ({"fingers": SHADOW.fingers[:4]}, r"reach.rest: give an array of NumPy of shape \(4,\)"),
        ({"reach": replace(SHADOW.reach, most=np.zeros(5))}, r"reach.most: .* \(5, 5\)"),
        ({"fingers": with_thumb(links=("thproximal", "x", "y"))}, "no link 'x'"),
        ({"fingers": with_thumb(links=("thproximal",), radii=(0.01,))}, "ff has 3 links and th 1"),
        ({"fingers": with_thumb(radii=(0.01,))}, "finger th: give a radius for each of its 3"),
        ({"fingers": with_thumb(links=THUMB.links[::-1])}, "thmiddle does not hang from thdistal"),
        ({"start": {"FFJ9": 0.1}}, "start: there is no joint 'FFJ9'"),
        ({"start": {"FFJ3": 9.0}}, "joint FFJ3 begins at 9.0, outside its range"),
        ({"body": with_joint("FFJ3", range=(0.3, 1.5))}, "is without 0; say in start where"),
        ({"servos": {**SHADOW.servos, "TAIL": Servo()}}, "servos: there is no actuator of 'TAIL'"),
        ({"servos": {**SHADOW.servos, "FFJ3": Servo(finger=5)}}, "give 0 to 4, or None"),
        ({"servos": {**SHADOW.servos, "FFJ3": Servo(rest=9.0)}}, "servo FFJ3: rest is 9.0, outs"),
        ({"reach": replace(SHADOW.reach, rest=[0.0] * 5)}, "reach.rest: give an array of NumPy"),
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
        ({"body": replace(BODY, actuators=BODY.actuators * 2)}, "WRJ2 is moved by two actuators"),
        (
            {
                "body": replace(
                    BODY,
                    couplings=(*BODY.couplings, Coupling("X", ("FFJ3",), (0, 1))),
                    actuators=(*BODY.actuators, Actuator("X", 1.0, 1.0)),
                )
            },
            "joint FFJ3 is moved by two actuators",
        ),
        ({"body": replace(BODY, links=())}, "the first link must be 'forearm'"),
        ({"body": with_palm(mass=-1.0)}, "link palm: mass: Expected .* >= 0"),
        (
            {"body": with_palm(geoms=(Geom("sphere", (1,), left_size=(0,)),))},
            "palm: geoms: .* > 0.*left_size",
        ),
        (
            {"body": with_palm(geoms=(Geom("sphere", (1,), left_quat=(0, 0)),))},
            r"palm: geoms: .* length 4 - at .\$\[0\]\.left_quat",
        ),
        ({"fingers": with_thumb(tip=(0, 0))}, "finger th: tip: Expected .* length 3"),
        ({"body": with_joint("FFJ3", axis=(1, 0))}, "link ffproximal: joint: .* length 3"),
        ({"body": with_joint("FFJ3", range=(1.5, -0.3))}, "rest is 0.75, outside its range"),
        ({"body": with_palm(pos=(0, 0))}, "link palm: pos: Expected .* length 3"),
        ({"body": with_palm(pos=(0, 0, np.nan))}, "link palm: pos: Expected .float., got .null."),
        ({"body": with_palm(geoms=(Geom("cube", (1,)),))}, "palm: .* enum value 'cube'"),
        (
            {"body": replace(BODY, actuators=(Actuator("FFJ3", -1.0, 1.0),))},
            "actuators: Expected .* > 0",
        ),
        ({"body": replace(BODY, excluded=(("palm", "x"),))}, "excluded: there is no link 'x'"),
        ({"body": replace(BODY, locked=("x",))}, "locked: there is no joint 'x'"),
        ({"body": replace(BODY, reduced_ranges={"x": (0, 1)})}, "reduced_ranges: .* joint 'x'"),
    ],
)
def test_parts_that_do_not_go_together(changes, said):
    with pytest.raises(CadenzaError, match=f"^hand shadow: .*{said}"):
        replace(SHADOW, **changes)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"body": replace(BODY, links=tuple(replace(i, inertia=(1, 0, 0)) for i in BODY.links))},
            "inertia",
        ),
        ({"body": replace(BODY, links=(*BODY.links, BODY.links[-1]))}, "repeated name .*thdistal"),
        ({"body": with_palm(geoms=(Geom("box", (1,)),))}, "size 1 must be positive"),
        ({"fingers": with_thumb(name="ff")}, "repeated name 'rh_fftip'"),
    ],
)
def test_what_the_physics_engine_refuses(changes, said, monkeypatch):
    hand = replace(SHADOW, **changes)
    monkeypatch.setattr("cadenza.scene.scene.hand_named", lambda _: hand)
    with pytest.raises(CadenzaError, match=rf"^hand shadow, keyboard piano: MuJoCo [^\n]*{said}"):
        build_scene(SceneConfig())
