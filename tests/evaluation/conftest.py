"""Agents of tests are found by name, as those of a user in the working folder are."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
