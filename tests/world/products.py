"""Records, pairs and corrected records of random numbers, to be written to archive files."""

import dataclasses

import numpy as np

from compasslib import angles
from compasslib.archive import netcdf
from compasslib.archive.attributes import Site
from compasslib.records import BAD, GOOD, MISSING, CorrectedRecord, Pairs, Record, ReferenceCompass, SlowShear

SITE = Site("EG4", latitude=65.3333, longitude=-32.9550, water_depth_m=894.0)
USUAL = {
    "institution": "Institute of the Sea",
    "project": "East Greenland",
    "principal_investigator": "A. Fram",
    "principal_investigator_email": "fram@sea.example",
    "principal_investigator_url": "https://sea.example/fram",
    "publisher_name": "B. Irminger",
    "publisher_email": "irminger@sea.example",
    "publisher_url": "https://sea.example",
    "naming_authority": "example.sea",
    "acknowledgement": "The crew.",
    "license": "CC-BY-4.0",
    "sea_area": "North Atlantic Ocean",
    "manufacturer": "Teledyne RDI",
    "serial_number": 1367,
}
PROCESSING = {
    "method": "exact",
    "coefficients": '{"A": 0.1}',
    "software_version": "1.0",
    "source_files": "raw/EG4/top.000, raw/EG4/deep.csv",
    "history": "2026-01-02T03:04:05Z headings corrected",
    "date_created": "2026-01-02T03:04:05Z",
}


def make_record(n: int = 200, m: int = 6, **other: object) -> Record:
    rng = np.random.default_rng(1)
    east, north = rng.normal(0, 0.2, (2, n, m))
    quality = np.ones((n, m), np.int8)
    quality[1::7, :1], east[1::7, :1], north[1::7, :1] = MISSING, np.nan, np.nan
    depth = 100 + rng.normal(0, 3, n)
    said: dict = {
        "time_s": 1189000000.25 + 1200.0 * np.arange(n),
        "east": east,
        "north": north,
        "bin_range_m": np.tile(8.0 + 8.0 * np.arange(m), (n, 1)),
        "heading_deg": angles.wrap360(rng.uniform(0, 360, n)),
        "pitch_deg": rng.normal(0, 3, n),
        "roll_deg": rng.normal(0, 3, n),
        "pressure_dbar": np.full(n, np.nan),
        "depth_m": depth,
        "temperature_c": rng.normal(2, 1, n),
        "supply_voltage": rng.normal(40, 1, n),
        "quality": quality,
        "heading_quality": np.ones(n, np.int8),
        "tests": np.zeros((n, m), np.int32),
        "beam_angle_deg": 20.0,
        "counts": {"ensembles": n, "bad checksum": 3},
        "warnings": ("one ensemble in three looks down", "Grönland ☂"),
    }
    return Record(**said | other)


def measured(n: int = 200, m: int = 6) -> dict:
    """Return the other variables of a PD0 file, as keyword arguments of a record."""
    rng = np.random.default_rng(3)
    up, error = rng.normal(0, 0.05, (2, n, m)).astype(np.float32)
    error[::5, :1] = np.nan
    counts = {name: rng.integers(0, 256, (n, m, 4), dtype=np.uint8) for name in ("echo", "correlation", "percent_good")}
    profiles = {"up": up, "error_velocity": error, **counts}
    return {"profiles": profiles, "pressure_dbar": rng.normal(100, 1, n), "recorded_in": "earth", "sound_speed": "kept"}


def make_product(n: int = 200, m: int = 6, *, uncorrectable: int = 20, **other: object) -> CorrectedRecord:
    record = make_record(n, m, **other)
    deviation = 25 * angles.sin_cos(record.heading_deg)[0]
    deviation[:uncorrectable] = np.nan
    return product_of(record, deviation)


def product_of(record: Record, deviation: np.ndarray) -> CorrectedRecord:
    corrected = angles.wrap360(record.heading_deg + deviation)
    declination = np.full(len(record.time_s), -17.5)
    east_recorded, north_recorded = angles.turn(record.east, record.north, declination[:, None])
    east, north = angles.turn(east_recorded, north_recorded, deviation[:, None])
    return CorrectedRecord(
        record=record,
        heading_corrected_deg=corrected,
        heading_uncertainty_deg=np.where(np.isfinite(corrected), 2.0, np.nan),
        heading_common_deg=np.where(np.isfinite(corrected), 1.5, np.nan),
        heading_corrected_quality=np.where(np.isfinite(corrected), GOOD, BAD).astype(np.int8),
        deviation_deg=deviation,
        branch_probability=np.where(np.isfinite(corrected), 0.9, np.nan),
        declination_deg=declination,
        east=east,
        north=north,
        east_recorded=east_recorded,
        north_recorded=north_recorded,
        east_uncertainty=np.abs(north) * np.deg2rad(2.0),
        north_uncertainty=np.abs(east) * np.deg2rad(2.0),
        velocity_quality=np.where(np.isfinite(east), GOOD, BAD).astype(np.int8),
    )


def make_pairs(n: int = 50) -> Pairs:
    rng = np.random.default_rng(2)
    others = {"warnings", "expected_m_s", "veer_deg", "doubts", "reference_index", "reference_names", "time_s"}
    others |= {"compass", "slowed", "slow_shear", "delay_h", "speed_late_h"}
    arrays = [field.name for field in dataclasses.fields(Pairs) if field.name not in others]
    values: dict = {name: rng.normal(10, 1, n) for name in arrays}
    values |= {"reference_index": np.arange(n, dtype=np.int8) % 2, "reference_names": ("deep", "mid")}
    if n:
        values["pitch_deg"][0] = np.nan
    values["time_s"] = 1189000000.0 + 3600.0 * np.arange(n)
    return Pairs(
        **values,
        warnings=("few pairs to the north",),
        expected_m_s=(0.046, 0.031),
        veer_deg=1.5,
        delay_h=0.25,
        speed_late_h=0.5,
        doubts=((12.0, "the references differ"),),
        compass=ReferenceCompass("deep", 2.0, 2.9, 0.5),
        slowed=((1, 1.189e9, 1.19e9, 0.4),),
        slow_shear=SlowShear(0.012, 14.0, 0.5, 1.3),
    )


def write(path, product=None, *, attributes=USUAL, site=SITE):
    netcdf.write_corrected(path, product or make_product(), site=site, attributes=attributes, processing=PROCESSING)
    return path
