"""Would catch sizes of causes on the axis of the power curve that are not those of a tool that knows the noise."""

import numpy as np
import power
import pytest

from tests.world import pairs as sea


def test_ratio_in_simulated_water_is_that_of_the_exact_covariance():
    world = sea.make(5, wide=True, n=600, slow_water=sea.SlowWater(4.0, 10.0, 0.01, 5.0))
    speed, angle, turn = np.abs(world.flow), np.angle(world.flow), np.deg2rad(3.0) * (np.arange(600) > 200)
    apart, along = np.abs(np.arange(600)[:, None] - np.arange(600)), np.cos(angle[:, None] - angle)
    red_m_s, memory_h, white_m_s = world.noise
    covariance = (np.deg2rad(4.0) * speed) * (np.deg2rad(4.0) * speed)[:, None] * np.exp(-apart / 240.0)
    covariance += (0.01**2 * np.exp(-apart / 120.0) + red_m_s**2 * np.exp(-apart / memory_h)) * along
    covariance += np.diag(white_m_s**2 + (np.deg2rad(0.5) * speed) ** 2)
    columns = speed[:, None] * np.column_stack([turn, power.waves(world.heading)])
    exact = np.linalg.norm(power.beyond(np.linalg.solve(np.linalg.cholesky(covariance), columns)))
    assert power.known_noise_ratio(world, turn) == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize(
    ("names", "driver", "effect"),
    [
        (["hard_iron_step"], True, True),
        (["heading_slip"], True, False),
        (["episode"], True, False),
        (["heeling"], False, False),
        (["hard_iron_step", "heeling"], False, False),
    ],
)
def test_all_causes_of_a_mooring_must_be_named(names, driver, effect):
    step = {"side": "compass", "level": "effect", "effect": "hard_iron_step", "driver": "time"}
    diagnosis = {"sides": {"compass": 0.9, "clock": 0.0}, "unexplained": None, "findings": [step]}
    assert power.named(names, diagnosis) == {"detected": True, "driver": driver, "effect": effect}
    unsure = {"sides": {"compass": 0.4}, "unexplained": None, "findings": [step | {"level": "side"}]}
    assert not any(power.named(names, unsure).values())
