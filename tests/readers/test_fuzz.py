"""Would catch damage at random that crashes or hangs a reader or becomes data (12 s, or COMPASSLIB_FUZZ_SECONDS)."""

import os

from tests.world import fuzz


def test_random_damage_causes_no_crash_hang_or_false_data():
    seconds = float(os.environ.get("COMPASSLIB_FUZZ_SECONDS", "12"))
    counts = fuzz.run(seconds, int(os.environ.get("COMPASSLIB_FUZZ_SEED", "7")))
    kinds = "pd0,table,acm_table,mmp text,mmp binary,nmea0183,iaga2002,netcdf,rdi_text,pd12,yaml"
    for kind in kinds.split(","):
        # Both must occur; otherwise the damage is too weak or too strong to be informative.
        assert counts[f"{kind}: read"] and counts[f"{kind}: refused"], counts
