"""Lets a script of this folder run by its path: imports are looked for beside the folders."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
