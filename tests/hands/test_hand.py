"""Hands whose parts do not go together are refused with a clear line; what is drawn of others."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from cadenza import CadenzaError, SceneConfig
from cadenza.hands.body import Actuator, Body, Coupling, Geom
from cadenza.hands.servo import Servo
from cadenza.hands.shadow import SHADOW
from cadenza.hands.shell import Shell, across, bevelled, ring, rounded_box, surface
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


def with_body(**changes: Any) -> dict[str, Any]:
    return {"body": replace(BODY, **changes)}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fingers": (THUMB,) * 9}, "has 9 fingers; give 1 to 8"),
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
        (with_body(links=BODY.links[1:]), "the first link must be 'forearm'"),
        (with_body(links=(*BODY.links[:2], BODY.links[3])), "'palm', its parent"),
        (
            with_body(couplings=(Coupling("FFJ0", ("FFJ9",), (0, 1)),)),
            "coupling FFJ0: there is no joint 'FFJ9'",
        ),
        (with_body(actuators=(Actuator("TAIL", 1.0, 1.0),)), "no joint or coupling 'TAIL'"),
        (with_body(actuators=BODY.actuators * 2), "WRJ2 is moved by two actuators"),
        (
            with_body(
                couplings=(*BODY.couplings, Coupling("X", ("FFJ3",), (0, 1))),
                actuators=(*BODY.actuators, Actuator("X", 1.0, 1.0)),
            ),
            "joint FFJ3 is moved by two actuators",
        ),
        ({"body": with_palm(mass=-1.0)}, "link palm: mass: Expected .* >= 0"),
        (
            {"body": with_palm(geoms=(Geom("sphere", (1,), left_size=(0,)),))},
            "palm: geoms: .* > 0.*left_size",
        ),
        ({"fingers": with_thumb(tip=(0, 0))}, "finger th: tip: Expected .* length 3"),
        ({"body": with_joint("FFJ3", axis=(1, 0))}, "link ffproximal: joint: .* length 3"),
        ({"body": with_palm(quat=(0, 0, 0, 0))}, "link palm: quat 0 0 0 0 is no rotation"),
        ({"body": with_palm(pos=(0, 0, np.nan))}, "link palm: pos: Expected .float., got .null."),
        ({"body": with_palm(geoms=(Geom("cube", (1,)),))}, "palm: .* enum value 'cube'"),
        (with_body(actuators=(Actuator("FFJ3", -1.0, 1.0),)), "actuators: Expected .* > 0"),
        (with_body(excluded=(("palm", "x"),)), "excluded: there is no link 'x'"),
        (with_body(locked=("x",)), "locked: there is no joint 'x'"),
        (with_body(reduced_ranges={"x": (0, 1)}), "reduced_ranges: .* joint 'x'"),
    ],
)
def test_parts_that_do_not_go_together(changes, message):
    with pytest.raises(CadenzaError, match=f"^hand shadow: .*{message}"):
        replace(SHADOW, **changes)


@pytest.mark.parametrize(
    ("changes", "message"),
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
def test_what_the_physics_engine_refuses(changes, message, monkeypatch):
    hand = replace(SHADOW, **changes)
    monkeypatch.setattr("cadenza.scene.scene.hand_named", lambda _: hand)
    with pytest.raises(
        CadenzaError, match=rf"^hand shadow, keyboard piano: MuJoCo [^\n]*{message}"
    ):
        build_scene(SceneConfig())


HULLS = {
    "rod": across(0.02, 0.01, 0.008),
    "disc": ring(0.04, 0.0, 0.006),
    "box": rounded_box((0.02, 0.03, 0.04), (0.01, 0.0, 0.0), 0.004),
    "cone": ((0.0, 0.0, 0.0, 0.02), (0.0, 0.0, 0.06, 0.008)),
}


def points_of(balls: tuple[tuple[float, float, float, float], ...]) -> np.ndarray:
    """Points on the balls, at random."""
    directions = np.random.default_rng(0).normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.concatenate([np.array(ball[:3]) + ball[3] * directions for ball in balls])


@pytest.mark.parametrize("name", HULLS)
def test_a_surface_is_that_of_the_convex_hull(name):
    balls = HULLS[name]
    vertices, normals, triangles = surface(balls, meridians=48, parallels=32)
    hull = ConvexHull(points_of(balls))
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert volume == pytest.approx(hull.volume, rel=0.15)  # turned outwards, so not negative
    outside = hull.equations[:, :3] @ vertices.T + hull.equations[:, 3:]
    assert outside.max() < 2e-4
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)


def test_a_bevelled_box_is_the_hull_of_its_corners():
    vertices, normals, triangles = bevelled((0.02, 0.03, 0.04), 0.004)
    hull = ConvexHull(vertices)
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    across = np.cross(b - a, c - a)
    assert np.einsum("ij,ij->i", a, across).sum() / 6 == pytest.approx(hull.volume)
    assert np.linalg.norm(across, axis=1).sum() / 2 == pytest.approx(hull.area)
    assert (vertices * normals).sum(axis=1) == pytest.approx(np.abs(normals) @ [0.02, 0.03, 0.04])
    assert np.abs(vertices).max(axis=0) == pytest.approx([0.02, 0.03, 0.04])


def test_the_left_shell_is_the_mirror_image():
    shell = Shell(((0.01, 0.02, 0.03, 0.004),))
    assert shell.mirrored("right") == shell
    assert shell.mirrored("left").balls == ((-0.01, 0.02, 0.03, 0.004),)
