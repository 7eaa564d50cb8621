"""What every room stands on: angles, records, errors, the exact compass, the earth's field."""
