"""The doors are tested on the small sensor and the camera of the live page's tests."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "studio"))
