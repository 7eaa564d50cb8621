"""Files damaged at random: a few seconds in every run, hours at will by COMPASSLIB_FUZZ_SECONDS and _SEED."""

import os

import fuzz


def test_nothing_that_was_never_recorded_no_crash_no_hang():
    seconds = float(os.environ.get("COMPASSLIB_FUZZ_SECONDS", "12"))
    counts = fuzz.run(seconds, int(os.environ.get("COMPASSLIB_FUZZ_SEED", "7")))
    for kind in (
        "pd0",
        "table",
        "acm_table",
        "mmp text",
        "mmp binary",
        "nmea0183",
        "iaga2002",
        "netcdf",
        "rdi_text",
        "pd12",
        "yaml",
    ):
        # Both must happen, or the damages are too weak or too strong to show anything.
        assert counts[f"{kind}: read"] and counts[f"{kind}: refused"], counts
