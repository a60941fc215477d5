"""What a plant's fit knows of the drive: how set-points become references."""

import numpy as np
import pytest

from hil.design.plant_problem import straight_line


@pytest.mark.parametrize("periods", [4, 8, 16])
def test_a_reference_in_steps_of_the_control_period_has_the_images_of_its_samples(periods: int) -> None:
    """Against the sum over the samples of the line up to a set-point and down from it."""
    control_s = 250e-6
    sync_s = periods * control_s
    frequency = np.array([3.0, 37.0, 463.0, 537.0, 963.0, 1537.0])
    weights = np.concatenate([np.arange(1, periods + 1), np.arange(periods - 1, 0, -1)]) / periods**2
    instants = control_s * np.arange(len(weights))
    summed = np.exp(-2j * np.pi * frequency[:, np.newaxis] * instants) @ weights
    np.testing.assert_allclose(straight_line(frequency, sync_s, control_s), summed, atol=1e-12)
