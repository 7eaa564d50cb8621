"""Calibrations that need no mooring: platform, magnetometer, swing by GNSS, two heads on one frame."""
