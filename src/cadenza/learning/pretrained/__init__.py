"""The policies that come with the package, a folder for each song (docs/learning.md)."""

from pathlib import Path

from cadenza.errors import CadenzaError, quoted
from cadenza.learning.policy_folder import POLICY_FILE


def pretrained_folder(song: str) -> Path:
    """The folder of the policy that plays a bundled song; raises CadenzaError if there is none."""
    here = Path(__file__).parent
    names = sorted(path.parent.name for path in here.glob(f"*/{POLICY_FILE}"))
    for name in names:
        if name.lower() == song.lower():
            return here / name
    raise CadenzaError(
        f"no pretrained policy for {quoted(song)}: choose from {', '.join(names)}, or train one "
        "with cadenza train"
    )
