"""Effects on the direction of magnetic north: secular variation, storms, daily variation, declination errors."""

from __future__ import annotations

from dataclasses import dataclass

from compasslib import angles
from compasslib.effects.effect import Effect, Proportional, Scene, parameter
from compasslib.types import Floats


@dataclass(frozen=True)
class SecularVariation(Effect):
    """Magnetic north drifts differently from the declination that was applied."""

    name = "secular_variation"
    words = "magnetic north drifts more than the declination that was applied"
    recordings = ("mooring", "declination")
    acts_on = "north"
    literature = "IGRF's rate of change; east positive"

    deg_year: float = parameter("degrees/year", "drift beyond what was applied", 1.0, usual=0.5)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x + self.deg_year * scene.years


# Storms and daily variation.
@dataclass(frozen=True)
class FieldDisturbance(Proportional):
    """Magnetic north moves by a share of the declination variation recorded at an observatory."""

    name, driver = "field_disturbance", "observatory"
    words = "magnetic north moved as the observatory recorded it, most of all on these dates"
    recordings = ("mooring", "declination")
    acts_on = "north"
    literature = "declination of an observatory minus its quiet value; east positive"
    needs = ("declination_observatory",)

    share: float = parameter("1", "share of the observatory's variation", 1.0)


@dataclass(frozen=True)
class VectorDisturbance(Proportional):
    """Magnetic north moves by shares of both horizontal components recorded at an observatory."""

    name, driver = "field_disturbance", "observatory"
    acts_on = "north"
    literature = "(dE cos D - dN sin D)/H, a transfer term for either component; east positive"
    needs = ("declination_observatory", "horizontal_observatory")

    across: float = parameter("1", "share of the observatory's variation across its magnetic north, over H", 1.0)
    along: float = parameter("1", "share of its variation along magnetic north, over H", 1.0)


@dataclass(frozen=True)
class IndexedDisturbance(Effect):
    """The uncertainty of magnetic north grows with a global storm index; its actual variation is unknown."""

    name, driver = "field_disturbance", "index"
    detector = "directions that scatter more where the index is larger"
    acts_on = "north"
    literature = "standard deviation c ap/H (Bartels 1957 for ap); either way"
    needs = ("storm_index",)

    nT_ap: float = parameter("nT", "across magnetic north, one standard deviation a unit of ap", 5.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x + self.nT_ap * scene.departures["storm_index"] / scene.horizontal_nT / angles.DEGREE


# Declination error: a wrong number in the metadata.
@dataclass(frozen=True)
class DeclinationError(Effect):
    """The declination that was applied has a constant error."""

    name, driver = "declination_error", ""
    words = "the declination is off by a constant"
    recordings = ("mooring", "declination")
    detector = "an observatory's mean against the model"
    acts_on = "north"
    literature = "von Appen 2015, eq. (2): inseparable from A, mean shear and mounting; east positive"

    error_deg: float = parameter("degrees", "true minus applied declination", 1.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x + self.error_deg
