"""Path setup so that a script of this folder can run by its path."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
