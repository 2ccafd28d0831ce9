"""What is drawn of the Shadow Hand: covers, joints and fingertips around its links.

The shapes are Cadenza's own, made to the lengths and widths of the links. Frames of the links: z
along the link, y out of the back of the hand, x towards the thumb of the right hand.
"""

from cadenza.hands.shell import METAL, RUBBER, SLEEVE, TRIM, Shell, across, ring


def _finger(name: str) -> dict[str, tuple[Shell, ...]]:
    return {
        f"{name}knuckle": (Shell(across(0.0058, 0.0, 0.0083), METAL),),
        f"{name}proximal": (
            Shell((*across(0.0026, 0.0118, 0.0080), *across(0.0019, 0.0335, 0.0070, 0.0004))),
            Shell(across(0.0066, 0.045, 0.0062), METAL),
        ),
        f"{name}middle": (
            Shell((*across(0.0019, 0.0088, 0.0068), *across(0.0014, 0.0168, 0.0064))),
            Shell(across(0.0058, 0.025, 0.0056), METAL),
        ),
        f"{name}distal": (
            Shell((*across(0.0014, 0.0072, 0.0064), (0.0, 0.0012, 0.0150, 0.0062))),
            Shell(((0.0, -0.0002, 0.0125, 0.0066), (0.0, 0.0004, 0.0254, 0.0067)), RUBBER),
        ),
    }


_THUMB = {
    "thbase": (Shell(((0.0, 0.0, 0.0, 0.0120),), METAL),),
    "thproximal": (Shell((*across(0.0030, 0.0130, 0.0098), *across(0.0022, 0.0270, 0.0086))),),
    "thhub": (Shell(across(0.0065, 0.0, 0.0082), METAL),),
    "thmiddle": (
        Shell((*across(0.0026, 0.0105, 0.0086), *across(0.0020, 0.0215, 0.0078))),
        Shell(((0.0, -0.0068, 0.032, 0.0068), (0.0, 0.0068, 0.032, 0.0068)), METAL),
    ),
    "thdistal": (
        Shell((*across(0.0018, 0.0080, 0.0076), (0.0, 0.0012, 0.0165, 0.0074))),
        Shell(((0.0, 0.0, 0.0135, 0.0080), (0.0, 0.0008, 0.0274, 0.0082)), RUBBER),
    ),
}

_PALM = (
    # From the wrist to the knuckles of the first three fingers
    Shell(
        (
            *across(0.0150, 0.0150, 0.0118),
            (0.0330, 0.0, 0.0760, 0.0092),
            (0.0110, 0.0008, 0.0800, 0.0098),
            (-0.0110, 0.0, 0.0760, 0.0092),
        )
    ),
    # The ball of the thumb
    Shell(
        (
            (0.0140, -0.0040, 0.0160, 0.0120),
            (0.0270, -0.0090, 0.0230, 0.0115),
            (0.0285, -0.0040, 0.0520, 0.0090),
            (0.0080, -0.0060, 0.0500, 0.0100),
        )
    ),
    # The plate on the back, and its edge
    Shell(
        (
            (-0.0120, 0.0106, 0.0240, 0.0032),
            (0.0150, 0.0106, 0.0240, 0.0032),
            (0.0275, 0.0088, 0.0640, 0.0032),
            (0.0110, 0.0098, 0.0650, 0.0032),
            (-0.0080, 0.0088, 0.0640, 0.0032),
        ),
        SLEEVE,
    ),
    Shell(((-0.0095, 0.0084, 0.0700, 0.0024), (0.0110, 0.0096, 0.0712, 0.0024)), TRIM),
    Shell(((0.0110, 0.0096, 0.0712, 0.0024), (0.0298, 0.0084, 0.0700, 0.0024)), TRIM),
    # Hinges of the knuckles
    Shell(((-0.0150, 0.0, 0.0880, 0.0064), (0.0370, 0.0, 0.0880, 0.0064)), METAL),
    Shell(across(0.0200, 0.0, 0.0108), METAL),
)

_LITTLE_FINGER_METACARPAL = (
    Shell(
        (
            (0.0110, 0.0, -0.0020, 0.0112),
            (0.0010, 0.0, 0.0140, 0.0112),
            (0.0000, 0.0, 0.0480, 0.0092),
            (0.0110, 0.0, 0.0480, 0.0090),
        )
    ),
    Shell(((-0.0035, 0.0, 0.0590, 0.0062), (0.0060, 0.0, 0.0590, 0.0062)), METAL),
)

_WRIST = (
    Shell(across(0.0140, 0.0, 0.0128), METAL),
    Shell((*across(0.0110, 0.0100, 0.0120), *across(0.0150, 0.0260, 0.0112)), SLEEVE),
)

_FOREARM = (
    # A sleeve with a round end, and bands about it
    Shell(
        (
            *ring(0.0380, 0.0390, 0.0300, -0.003, 0.0110),
            *ring(0.0290, 0.1480, 0.0040, -0.008, 0.0090),
        ),
        SLEEVE,
    ),
    Shell(ring(0.0386, 0.0420, 0.0034, -0.003, 0.0110), METAL),
    Shell(ring(0.0312, 0.1490, 0.0034, -0.008, 0.0090), TRIM),
    Shell(
        (
            *ring(0.0275, 0.1500, 0.0050, -0.008, 0.0085),
            *ring(0.0190, 0.1960, 0.0060, -0.008, 0.0080),
        ),
        METAL,
    ),
)

SHELLS = {
    "forearm": _FOREARM,
    "wrist": _WRIST,
    "palm": _PALM,
    "lfmetacarpal": _LITTLE_FINGER_METACARPAL,
    **{link: shells for name in ("ff", "mf", "rf", "lf") for link, shells in _finger(name).items()},
    **_THUMB,
}
"""The name of a link -> what is drawn of it."""
