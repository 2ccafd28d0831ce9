"""`cadenza hand measure`: how a hand sits over the keys, and how far its fingers reach."""

from dataclasses import dataclass

import tyro


@dataclass(frozen=True)
class MeasureHand:
    """Measure a hand, which takes some minutes: how it sits over the keys, how far it reaches.

    What is found of a TOML file is written beside it; the `Reach` of another hand is printed.
    Example: cadenza hand measure leap.toml
    """

    hand: tyro.conf.Positional[str]
    """A TOML file that describes an MJCF or URDF, or the name of a hand, or module:NAME."""


def measure(command: MeasureHand) -> None:
    from dataclasses import asdict, replace
    from pathlib import Path

    from cadenza.agents.planner.hand_measurement import ReachMeasurement, place
    from cadenza.files import write_json
    from cadenza.hands.mjcf import TOML, measurement_of
    from cadenza.hands.registry import hand_named

    path = Path(command.hand)
    if path.suffix != TOML:
        reach = ReachMeasurement(hand_named(command.hand))
        print("fingertips at rest:", *reach.at_rest(), sep="\n    ")
        found = reach.measure().items()
        print(
            "reach=Reach(", *(f"{name}=np.array({v.tolist()})," for name, v in found), sep="\n    "
        )
        print("    forearm_width=forearm.WIDTH,\n)")
        return
    file, measurement = place(path)
    reach = ReachMeasurement(file.hand(measurement))
    print("fingertips at rest:", *reach.at_rest(), sep="\n    ", flush=True)
    print(*reach.slow(), sep="\n", flush=True)
    measured = {name: values.tolist() for name, values in reach.measure().items()}
    write_json(measurement_of(path), asdict(replace(measurement, reach=measured)))
    print(f"{measurement_of(path)}: measured")
