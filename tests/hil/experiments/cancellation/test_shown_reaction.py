"""The reaction of a gear on its motor, as the torque of probing runs shows it: what is believed of it."""

import numpy as np
import pytest

from hil.experiments.cancellation.probing.motion import GearReaction
from hil.experiments.cancellation.probing.reaction import ShownReaction


def shown(load: float, error: float = 0.02, power: float = 0.9, turned_nm: float = 0.3) -> ShownReaction:
    return ShownReaction(load, error, power, turned_nm, np.zeros(2))


def test_a_reaction_that_explains_the_load_is_believed_with_the_friction_that_it_leaves() -> None:
    """A motor that is driven by its load carries it and friction less: τ_g is larger than its torque."""
    assert shown(0.8).estimate == GearReaction(1.0, pytest.approx(0.06))
    assert shown(1.4, turned_nm=-0.55).estimate == GearReaction(1.0, pytest.approx(0.22))


@pytest.mark.parametrize(
    "doubtful",
    [shown(0.8, error=0.25), shown(0.8, power=0.2), shown(0.1), shown(-0.14, turned_nm=0.69), shown(2.5, turned_nm=0.3)],
    ids=["noise", "something else", "hardly any", "the wrong way", "friction that pushes"],
)
def test_what_is_no_reaction_for_certain_is_not_allowed_for(doubtful: ShownReaction) -> None:
    assert doubtful.estimate == GearReaction(0.0, 0.0)
