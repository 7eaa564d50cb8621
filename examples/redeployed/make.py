"""Write the simulated raw files of this cruise: python examples/redeployed/make.py [FOLDER]"""

import sys
from pathlib import Path

from tests.world import redeployed

redeployed.write_cruise(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent)
