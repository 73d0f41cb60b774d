"""The experiments are scripts beside the package; here they are imported like one."""

import sys
from pathlib import Path

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
if str(EXPERIMENTS) not in sys.path:
    sys.path.insert(0, str(EXPERIMENTS))
    sys.path.append(str(EXPERIMENTS / "tables"))
