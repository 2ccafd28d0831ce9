"""Writes folders of policies of the version before anew. To go with the next version.

python -m cadenza.learning.renew POLICY...
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

from cadenza.errors import CadenzaError, CadenzaWarning
from cadenza.learning.policy_folder import load_policy, save_policy
from cadenza.learning.sealed_folder import read_sealed


def renew(folder: Path) -> None:
    """Raises: CadenzaError: there is no policy, or no room."""
    facts, _ = read_sealed(folder, "policy", {})
    save_policy(folder, load_policy(folder), facts["about"])


if __name__ == "__main__":
    warnings.simplefilter("ignore", CadenzaWarning)
    try:
        for name in sys.argv[1:]:
            renew(Path(name))
    except (CadenzaError, OSError) as error:
        sys.exit(str(error))
