"""Fits the weights of `cadenza.fingering.difficulty` to what the planner reaches.

    python tools/fit_difficulty.py play repertoire:train etudes:100 -o fitted.jsonl
    python tools/fit_difficulty.py play repertoire:valid etudes:30:1 -o checked.jsonl
    python tools/fit_difficulty.py fit fitted.jsonl checked.jsonl
    python tools/fit_difficulty.py compare BENCH

`play` has the planner play the opening of songs of libraries (see `cadenza libraries`) or folders,
and writes a line for each. Run again, it goes on where it was stopped. `fit` fits the weights to
the first file, prints them as they stand in the module, and says how well the grades go with the
F1 of the songs in each file. Fingers are found for all songs, as the planner does. `compare` says
how well the grades of songs go with what agents have reached in a folder of `cadenza bench`.
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import astuple
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray
from openings import add_options, add_row, drawn_songs, metrics_of, opening, rows_of
from scipy.optimize import nnls
from scipy.stats import ConstantInputWarning, spearmanr

from cadenza.agents.planner.config import PlannerConfig, Refinement
from cadenza.errors import CadenzaError, errors_in_a_line
from cadenza.evaluation.results import read_results
from cadenza.evaluation.summary import summarize
from cadenza.fingering.difficulty import EASIEST, ODDS, DifficultyModel, Features, features_of
from cadenza.fingering.search import find_fingering
from cadenza.music.libraries.library import load_score
from cadenza.scene.scene import build_scene
from cadenza.tasks.goal_track import players_of

Array = NDArray[np.float64]

HANDS = players_of(build_scene())
EASIEST_F1 = 0.97  # expected of what is of grade 1
MIN_ERROR = 1e-3  # of 1 - F1: a song without an error is not infinitely easy
RIDGE = 0.3  # features that go together share their weight


@errors_in_a_line()
def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    playing = commands.add_parser("play", help="have the planner play")
    add_options(playing, seconds=15.0)
    playing.add_argument(
        "--method",
        default="none",
        choices=get_args(Refinement),
        help="--planner.method of cadenza play",
    )
    fitting = commands.add_parser("fit", help="fit the weights, and check them")
    fitting.add_argument("fitted", type=Path, help="what is fitted to")
    fitting.add_argument("checked", type=Path, nargs="*", help="what is looked at only")
    comparing = commands.add_parser("compare", help="compare the grades with what agents reach")
    comparing.add_argument("bench", type=Path, help="folder of `cadenza bench`")
    options = parser.parse_args()
    if options.command == "play":
        play(options.libraries, options.output, options.most, options.seconds, options.method)
    elif options.command == "fit":
        fit(options.fitted, options.checked)
    else:
        compare(options.bench)


def play(libraries: list[str], output: Path, most: int | None, seconds: float, method: str) -> None:
    rows = rows_of(output) if output.exists() else []
    if any((row["seconds"], row["method"]) != (seconds, method) for row in rows):
        raise CadenzaError(
            f"{output}: holds other --seconds or another --method; choose another file"
        )
    done = {row["song"] for row in rows}
    planner = PlannerConfig(method=method)  # type: ignore[arg-type]
    for library, song in drawn_songs(libraries, most):
        if song.name in done:
            continue
        done.add(song.name)
        f1 = metrics_of(opening(song.load(), seconds), planner)["f1"]
        row = {"library": library, "song": song.name, "seconds": seconds, "method": method}
        add_row(output, row | {"f1": f1})


def fit(fitted: Path, checked: list[Path]) -> None:
    data = {path: data_of(path) for path in (fitted, *checked)}
    features, errors, _ = data[fitted]
    model = fitted_model(features, errors)
    print(f"FITTED = {model}\n")
    for path, (features, errors, libraries) in data.items():
        for library in dict.fromkeys(libraries):
            of_it = np.array(libraries) == library
            grades = np.array([model.grade(Features(*row)) for row in features[of_it]])
            report(f"{path.name}, {library}", grades, errors[of_it])


def data_of(path: Path) -> tuple[Array, Array, list[str]]:
    """Features (N, F), logarithms of the odds of an error (N,), and libraries of N songs."""
    rows = rows_of(path)
    features = []
    for row in rows:
        score, _ = find_fingering(opening(load_score(row["song"]), row["seconds"]), HANDS)
        features.append(astuple(features_of(score)))
    error = np.maximum(1 - np.array([row["f1"] for row in rows]), MIN_ERROR)
    return np.array(features), np.log(error / (1 - error)), [row["library"] for row in rows]


def fitted_model(features: Array, errors: Array) -> DifficultyModel:
    """Least squares with weights of zero or more."""
    x = np.log1p(features)
    scale = x.std(axis=0)
    scale[scale == 0] = 1.0  # what all songs have as much of gets no weight
    ridge = np.eye(x.shape[1]) * np.sqrt(RIDGE * len(x))
    centred = np.concatenate([(x - x.mean(axis=0)) / scale, ridge])
    weights, _ = nnls(centred, np.append(errors - errors.mean(), np.zeros(len(ridge))))
    weights /= scale
    constant = errors.mean() - x.mean(axis=0) @ weights
    easiest = np.log((1 - EASIEST_F1) / EASIEST_F1)
    grades = np.append(weights, constant - easiest) / np.log(ODDS)
    *per_feature, start = (round(float(grade), 1) for grade in grades)
    return DifficultyModel(round(EASIEST + start, 1), Features(*per_feature))


def compare(bench: Path) -> None:
    """Compares the grade of each song that has one with its mean F1 over the seeds."""
    about = summarize(read_results(bench), bench.name)
    grades = np.array([piece.difficulty for piece in about.pieces])
    libraries = np.array([piece.library for piece in about.pieces])
    for agent, f1 in zip(about.agents, about.by_piece["f1"].value, strict=True):
        for library in dict.fromkeys(libraries):
            of_it = (libraries == library) & ~np.isnan(grades) & ~np.isnan(f1)
            if of_it.sum() > 2:
                report(f"{agent}, {library}", grades[of_it], 1 - f1[of_it])


def report(name: str, grades: Array, errors: Array) -> None:
    rng = np.random.default_rng(0)
    draws = rng.integers(len(grades), size=(2000, len(grades)))
    with warnings.catch_warnings(action="ignore", category=ConstantInputWarning):
        drawn = [spearmanr(grades[draw], errors[draw]).statistic for draw in draws]
    low, high = np.nanpercentile(drawn, [2.5, 97.5])  # without draws of one song only
    least, middle, most = np.percentile(grades, [0, 50, 100])
    print(
        f"{name}: {len(grades)} songs, grades {least:.1f} to {most:.1f}, median {middle:.1f}; "
        f"rank correlation with 1 - F1 {spearmanr(grades, errors).statistic:.2f} "
        f"(95 % interval {low:.2f} to {high:.2f})"
    )


if __name__ == "__main__":
    main()
