"""Measures agents under disturbances that they do not know.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.robustness [SONG ...] [--seeds N]
        [--agents AGENT ...] [-o docs/results]

An agent is a name, or NAME=FOLDER of a policy or of practice, where {song} stands for the song.
Writes robustness.csv, a row for each play, from which it goes on.
"""

from __future__ import annotations

import csv
from dataclasses import replace
from itertools import product
from pathlib import Path

from benchmarks.arguments import one_or_more, parser_for
from cadenza.agents.rollout import play_episode
from cadenza.errors import errors_in_a_line
from cadenza.evaluation.tables import write_csv
from cadenza.performing.setup import find_player, set_up
from cadenza.tasks.config import DomainRandomization

SONGS = "MinuetInG", "TwinkleTwinkleLittleStar"
OFF = (0.8, 1.2)
DISTURBANCES = {
    "nothing": DomainRandomization(),
    "5 % noise on controls": DomainRandomization(control_noise=0.05),
    "actions 20 ms late": DomainRandomization(latency=(0.02, 0.02)),
    "masses, gains, springs, damping off by 20 %": DomainRandomization(
        mass=OFF, servo_gain=OFF, key_spring=OFF, joint_damping=OFF
    ),
    "noise of joints 0.02 rad, of slides 2 mm": DomainRandomization(
        joint_noise=0.02, slide_noise=0.002
    ),
}
METRICS = "note_onset_f1", "f1"


def played(song: str, agent: str, disturbance: DomainRandomization, seed: int) -> dict[str, str]:
    """The `METRICS` of an agent that plays a song in its task, but disturbed."""
    player = find_player(agent, song)
    disturbed = player.playing_in(replace(player.task, randomization=disturbance), None)
    with set_up(song, disturbed, seed=seed) as ready:
        metrics = play_episode(ready.task, ready.agent, seed).metrics
    return {name: str(metrics[name]) for name in METRICS}


@errors_in_a_line()
def main() -> None:
    """Plays, and writes after each play."""
    parser = parser_for(__doc__)
    parser.add_argument("songs", nargs="*", default=SONGS, help="bundled pieces or MIDI files")
    parser.add_argument("--seeds", type=one_or_more, default=4)
    parser.add_argument("--agents", nargs="+", default=["planner", "generalist"])
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/results"))
    options = parser.parse_args()
    table, rows = options.output / "robustness.csv", list[dict[str, str]]()
    if table.exists():
        with table.open(newline="") as file:
            rows = list(csv.DictReader(file))
    done = {tuple(row.values())[: -len(METRICS)] for row in rows}
    places, seeds = [*DISTURBANCES], range(options.seeds)
    for name, agent, song, seed in product(places, options.agents, options.songs, seeds):
        title, _, folder = agent.partition("=")
        if (name, title, song, str(seed)) in done:
            continue
        scores = played(song, folder.format(song=song) or title, DISTURBANCES[name], seed)
        rows.append({"disturbance": name, "agent": title, "song": song, "seed": str(seed)} | scores)
        print(*rows[-1].values(), flush=True)
        write_csv(table, sorted(rows, key=lambda row: places.index(row["disturbance"])))


if __name__ == "__main__":
    main()
