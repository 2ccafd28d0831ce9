"""Trains a policy for a song, and has it play.

python examples/train.py [SONG [STEPS]]

With 200000 steps, which take a few minutes, it plays Twinkle well. The folder "run" must not hold a
run already. JAX is needed: run
`make install`, or pip install '.[train]' in the folder of Cadenza's sources.
"""

from __future__ import annotations

import sys

import cadenza

song = sys.argv[1] if len(sys.argv) > 1 else "TwinkleTwinkleLittleStar"
steps = int(sys.argv[2]) if len(sys.argv) > 2 else 200_000

trained = cadenza.train(
    song,
    "run",  # metrics.jsonl has the learning curve; "cadenza curves run" draws it
    num_steps=steps,
    learning_starts=min(5_000, steps // 2),  # with random actions
    eval_interval=max(1, min(10_000, steps // 2)),
)
performance = cadenza.play(agent=trained.policy)
print(f"F1 {performance.metrics['f1']:.3f}")
performance.save("played")
