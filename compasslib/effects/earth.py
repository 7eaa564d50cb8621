"""Effects on the direction of magnetic north: secular variation, storms, daily variation, declination errors."""

from __future__ import annotations

from functools import partial

from compasslib import angles
from compasslib.effects.effect import additive, parameter

_north = partial(additive, acts_on="north")
_disturbance = partial(_north, name="field_disturbance")

SecularVariation = _north(
    "SecularVariation", "Magnetic north drifts differently from the declination that was applied.",
    lambda term, scene: term.deg_year * scene.years,
    name="secular_variation", recordings=("mooring", "declination"),
    words="magnetic north drifts more than the declination that was applied",
    literature="IGRF's rate of change; east positive",
    deg_year=parameter("degrees/year", "drift beyond what was applied", 1.0, usual=0.5),
)  # fmt: skip

# Storms and daily variation.
FieldDisturbance = _disturbance(
    "FieldDisturbance", "Magnetic north moves by a share of the declination variation recorded at an observatory.",
    driver="observatory", recordings=("mooring", "declination"), needs=("declination_observatory",),
    words="magnetic north moved as the observatory recorded it, most of all on these dates",
    literature="declination of an observatory minus its quiet value; east positive",
    share=parameter("1", "share of the observatory's variation", 1.0),
)  # fmt: skip
VectorDisturbance = _disturbance(
    "VectorDisturbance", "Magnetic north moves by shares of both horizontal components recorded at an observatory.",
    driver="observatory", needs=("declination_observatory", "horizontal_observatory"),
    literature="(dE cos D - dN sin D)/H, a transfer term for either component; east positive",
    across=parameter("1", "share of the observatory's variation across its magnetic north, over H", 1.0),
    along=parameter("1", "share of its variation along magnetic north, over H", 1.0),
)  # fmt: skip
IndexedDisturbance = _disturbance(
    "IndexedDisturbance",
    "The uncertainty of magnetic north grows with a global storm index; its actual variation is unknown.",
    lambda term, scene: term.nT_ap * scene.departures["storm_index"] / scene.horizontal_nT / angles.DEGREE,
    driver="index", detector="directions that scatter more where the index is larger", needs=("storm_index",),
    literature="standard deviation c ap/H (Bartels 1957 for ap); either way",
    nT_ap=parameter("nT", "across magnetic north, one standard deviation a unit of ap", 5.0),
)  # fmt: skip

# Declination error: a wrong number in the metadata.
DeclinationError = _north(
    "DeclinationError", "The declination that was applied has a constant error.", lambda term, _: term.error_deg,
    name="declination_error", driver="", recordings=("mooring", "declination"),
    detector="an observatory's mean against the model",
    words="the declination is off by a constant",
    literature="von Appen 2015, eq. (2): inseparable from A, mean shear and mounting; east positive",
    error_deg=parameter("degrees", "true minus applied declination", 1.0),
)  # fmt: skip
