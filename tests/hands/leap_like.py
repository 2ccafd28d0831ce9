"""An MJCF of a hand like the LEAP Hand, by figures: three fingers and a thumb, 16 motors."""

from pathlib import Path

TOML = """\
file = "leap.xml"
palm = "palm"
kp = 2.0
[fingers]
thumb = "thumb_tip"
index = "index_tip"
middle = "middle_tip"
ring = "ring_tip"
"""
LENGTHS = (0.016, 0.045, 0.035, 0.028)  # [m] from the knuckle to the tip
FINGER_RANGES = ((-0.5, 0.5), (-0.3, 1.8), (-0.2, 1.9), (-0.3, 1.8))
THUMB_RANGES = ((-0.3, 1.6), (-0.6, 1.2), (-0.4, 1.4), (-0.3, 1.5))


def finger(name: str, place: str, ranges: tuple[tuple[float, float], ...]) -> str:
    """Four links, the first of which spreads the finger and the others bend it."""
    text = f'<body name="{name}0" {place}>'
    for i, (length, (low, high)) in enumerate(zip(LENGTHS, ranges, strict=True)):
        axis = "0 -1 0" if i == 0 else "1 0 0"
        shape = f'type="capsule" size="0.008" fromto="0 0 0 0 0 {length}" mass="0.02"'
        text += f'<joint name="{name}_{i}" axis="{axis}" range="{low} {high}"/><geom {shape}/>'
        if i < 3:
            text += f'<body name="{name}{i + 1}" pos="0 0 {length}">'
    text += f'<site name="{name}_tip" pos="0 0 {LENGTHS[-1]}"/>'
    return text + "</body>" * 4


def mjcf() -> str:
    fingers = "".join(
        finger(name, f'pos="{x} 0 0.1"', FINGER_RANGES)
        for name, x in (("index", 0.034), ("middle", 0.0), ("ring", -0.034))
    )
    thumb = finger("thumb", 'pos="0.036 -0.02 0.03" euler="0 0.7 0"', THUMB_RANGES)
    motors = "".join(
        f'<position joint="{name}_{i}" kp="1" forcerange="-1.5 1.5"/>'
        for name in ("thumb", "index", "middle", "ring")
        for i in range(4)
    )
    return f"""<mujoco model="leap-like"><compiler angle="radian"/>
    <default><joint damping="0.08" armature="0.0005"/></default>
    <worldbody><body name="palm">
    <geom type="box" size="0.045 0.01 0.05" pos="0 0 0.05" mass="0.25"/>{fingers}{thumb}
    </body></worldbody><actuator>{motors}</actuator></mujoco>"""


def write_to(folder: Path) -> Path:
    """Write the files of the hand; return its TOML."""
    (folder / "leap.xml").write_text(mjcf())
    (folder / "leap.toml").write_text(TOML)
    return folder / "leap.toml"
