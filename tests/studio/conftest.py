"""The live page is tested on the bench devices of the capture room and the known skins of the shape room."""

import sys
from pathlib import Path

for room in ("capture", "shape"):
    sys.path.append(str(Path(__file__).parents[1] / room))
