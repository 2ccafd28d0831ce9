"""`cadenza hand measure`: how a hand sits over the keys, and how far its fingers reach."""

from dataclasses import dataclass

import tyro


@dataclass(frozen=True)
class MeasureHand:
    """Measure a hand, which takes some minutes: how it sits over the keys, how far it reaches.

    Measurements of a TOML file are written beside it; the `Reach` of another hand is printed.
    Example: cadenza hand measure leap.toml
    """

    hand: tyro.conf.Positional[str]
    """A TOML file that describes an MJCF or URDF, or the name of a hand, or module:NAME."""


def measure(command: MeasureHand) -> None:
    from dataclasses import asdict, replace
    from pathlib import Path

    from cadenza.agents.planner.hand_measurement import ReachMeasurement, place
    from cadenza.cli.printing import progress
    from cadenza.files import write_json
    from cadenza.hands.mjcf import TOML, measurement_of
    from cadenza.hands.registry import hand_named

    path = Path(command.hand)
    placed = place(path) if path.suffix == TOML else None
    hand = placed[0].hand(placed[1]) if placed else hand_named(command.hand)
    reach = ReachMeasurement(hand)
    print("fingertips at rest:", *reach.at_rest(), sep="\n    ", flush=True)
    for line in (*reach.slow(), *reach.swinging()) if placed else ():
        print(line, flush=True)
    with progress("measuring", "reaches") as advance:
        measured = {name: values.tolist() for name, values in reach.measure(advance).items()}
    if placed:
        write_json(measurement_of(path), asdict(replace(placed[1], reach=measured)))
        print(f"{measurement_of(path)}: measured")
    else:
        arrays = (f"{name}=np.array({values})," for name, values in measured.items())
        print("reach=Reach(", *arrays, sep="\n    ")
        print("    forearm_width=forearm.WIDTH,\n)")
