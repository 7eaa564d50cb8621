"""The seven moorings of the demonstration cruise: where they stand and what is simulated there.

Positions, depths and kinds of instruments are those of von Appen 2015, Table 1; currents, iron and serial numbers are
invented. Two things differ from the table. The bins of EG4's lower instrument begin nearer than its 114 m, because
between the means of two bins at 90 m and at 118 m there would be no pair within 20 m. And no lower instrument on the
bottom has a bin above the sphere in still water.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compasslib.nature.adcp import Adcp
from compasslib.nature.compass import Iron
from compasslib.nature.mooring import Rig
from compasslib.nature.pd0 import Setup
from compasslib.nature.profiler import Profiler
from compasslib.nature.water import Climate

DEPLOYED_S, RECOVERED_S = 1188864000.0, 1223078400.0  # 4 September 2007 and 4 October 2008, 00:00 UTC


@dataclass(frozen=True)
class MooringSpec:
    """One mooring: where it stands, what carries it, what spoils its upper compass, what hangs below."""

    name: str
    latitude_deg: float
    longitude_deg: float
    water_depth_m: float
    climate: Climate
    rig: Rig
    iron: Iron
    top: Adcp
    deep: Adcp | Profiler
    deep_depth_m: float = 0.0  # of a lower ADCP on the bottom; 0 where it hangs under the sphere


def _top(serial: int, coordinates: str = "earth", first_number: int = 1) -> Adcp:
    setup = Setup(
        kilohertz=300, looks_up=True, cells=27, cell_m=4.0, blank_m=0.88, first_bin_m=5.1, pings=60,
        coordinates=coordinates, serial=serial,
    )  # fmt: skip
    return Adcp(setup, noise_m_s=0.014, first_number=first_number)


def _workhorse(serial: int, cells: int, minutes: float) -> Adcp:
    setup = Setup(
        kilohertz=300, looks_up=True, cells=cells, cell_m=4.0, blank_m=4.0, first_bin_m=8.2, pings=45,
        coordinates="earth", serial=serial,
    )  # fmt: skip
    return Adcp(setup, noise_m_s=0.015, sample_s=60.0 * minutes)


def _long_ranger(serial: int, cells: int, minutes: float, *, looks_up: bool, cell_m: float, first_bin_m: float) -> Adcp:
    setup = Setup(
        kilohertz=75, looks_up=looks_up, cells=cells, cell_m=cell_m, blank_m=first_bin_m - cell_m,
        first_bin_m=first_bin_m, pings=40, coordinates="earth", serial=serial,
    )  # fmt: skip
    return Adcp(setup, noise_m_s=0.02, sample_s=60.0 * minutes)


def _rig(buoyancy_n: float, *, offset: float, wobble: float, rest: tuple[float, float]) -> Rig:
    return Rig(buoyancy_n, offset, wobble, *rest)


def _iron(*, hard_nt: tuple[float, float, float], soft_percent: tuple[tuple[float, float, float], ...]) -> Iron:
    """Return iron from its hard part and its soft part's excess over the unit matrix."""
    return Iron(hard_nt, tuple((*row,) for row in (np.eye(3) + 0.01 * np.array(soft_percent)).tolist()))


MOORINGS = (
    # On the shelf: weak flow, strong tides, headings round the whole circle; a third of the earth's field beside it.
    MooringSpec(
        "EG1", 65 + 30.0 / 60, -(33 + 8.8 / 60), 248.0,
        climate=Climate(mean_m_s=0.16, tide_m_s=0.14, cyclone_m_s=0.05),
        rig=_rig(2500.0, offset=40.0, wobble=24.0, rest=(-3.6, -3.2)),
        iron=_iron(hard_nt=(3300.0, -1500.0, -1200.0),
                   soft_percent=((1.5, 0.4, 0.3), (0.2, -0.8, -0.4), (0.3, -0.2, 1.0))),
        top=_top(8101), deep=_workhorse(8111, 35, minutes=5.0), deep_depth_m=248.0,
    ),
    # The minor case of the paper's Fig. 6: a tenth of the earth's field.
    MooringSpec(
        "EG2", 65 + 26.6 / 60, -(33 + 4.5 / 60), 268.0,
        climate=Climate(mean_m_s=0.18, tide_m_s=0.12, cyclone_m_s=0.08),
        rig=_rig(2500.0, offset=160.0, wobble=22.0, rest=(4.0, -2.6)),
        iron=_iron(hard_nt=(-600.0, 900.0, 500.0),
                   soft_percent=((0.8, 0.2, -0.1), (0.3, -0.4, 0.2), (-0.1, 0.1, 0.5))),
        top=_top(8102), deep=_workhorse(8112, 40, minutes=4.0), deep_depth_m=268.0,
    ),
    # Half of it; the upper instrument was left in beam coordinates.
    MooringSpec(
        "EG3", 65 + 23.2 / 60, -(33 + 1.0 / 60), 524.0,
        climate=Climate(mean_m_s=0.22, cyclone_m_s=0.28),
        rig=_rig(2000.0, offset=-75.0, wobble=20.0, rest=(-2.5, 3.6)),
        iron=_iron(hard_nt=(4200.0, 4100.0, -2500.0),
                   soft_percent=((2.0, -0.6, 0.4), (0.5, -1.5, 0.5), (0.3, 0.4, 1.5))),
        top=_top(8103, coordinates="beam"),
        deep=_long_ranger(7513, 52, minutes=7.0, looks_up=True, cell_m=8.0, first_bin_m=10.0), deep_depth_m=524.0,
    ),
    # The large case of Fig. 7: 1.3 of it, seen where the recorded heading runs backwards (beta near arg p + 180).
    MooringSpec(
        "EG4", 65 + 20.0 / 60, -(32 + 57.3 / 60), 894.0,
        climate=Climate(mean_m_s=0.28, cyclone_m_s=0.35),
        rig=_rig(2900.0, offset=-30.0, wobble=14.0, rest=(-3.0, 3.4)),
        iron=_iron(hard_nt=(8300.0, -13000.0, 1500.0),
                   soft_percent=((2.0, 0.5, 0.3), (-0.4, -1.0, -0.4), (0.2, 0.5, 1.0))),
        top=_top(8104), deep=_long_ranger(7514, 86, minutes=2.0, looks_up=False, cell_m=4.0, first_bin_m=5.6),
    ),
    # Three quarters, with a vertical part that tilts into the heading.
    MooringSpec(
        "EG5", 65 + 16.2 / 60, -(32 + 52.7 / 60), 1163.0,
        climate=Climate(mean_m_s=0.27, cyclone_m_s=0.40),
        rig=_rig(3600.0, offset=110.0, wobble=20.0, rest=(-3.0, -3.0)),
        iron=_iron(hard_nt=(-8300.0, 2500.0, 6000.0),
                   soft_percent=((2.5, 0.8, -0.5), (-0.6, -1.0, 0.4), (0.4, -0.3, 2.0))),
        top=_top(8105), deep=Profiler(first_s=0.0, bottom_m=1158.0, binary=False, serial=1405),
    ),
    # One and a half, seen where the compass is sluggish (beta within 130 degrees of arg p).
    MooringSpec(
        "EG6", 65 + 12.3 / 60, -(32 + 47.0 / 60), 1378.0,
        climate=Climate(mean_m_s=0.25, cyclone_m_s=0.40),
        rig=_rig(4800.0, offset=150.0, wobble=18.0, rest=(4.0, -2.0)),
        iron=_iron(hard_nt=(-4000.0, -17500.0, -2000.0),
                   soft_percent=((1.5, -0.5, 0.5), (0.8, -1.8, 0.3), (0.1, 0.4, 1.2))),
        top=_top(8106), deep=Profiler(first_s=2880.0, bottom_m=1373.0, binary=True, serial=1406),
    ),
    MooringSpec(
        "EG7", 65 + 7.3 / 60, -(32 + 41.1 / 60), 1585.0,
        climate=Climate(mean_m_s=0.22, cyclone_m_s=0.38),
        rig=_rig(5200.0, offset=15.0, wobble=22.0, rest=(-3.5, 2.5)),
        iron=_iron(hard_nt=(2000.0, 4700.0, 1800.0),
                   soft_percent=((1.8, 0.3, 0.2), (0.4, -0.9, -0.5), (-0.2, 0.3, 1.0))),
        top=_top(8107, first_number=60001), deep=Profiler(first_s=660.0, bottom_m=1580.0, binary=False, serial=1407),
    ),
)  # fmt: skip
