"""Write the simulated raw files of this cruise: python examples/lowered_adcp/make.py [FOLDER]"""

import sys
from pathlib import Path

from tests.world import lowered

lowered.write_station(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent)
