"""What is said of where axes stand when a motion is refused or stopped."""

import pytest

from hil.bench.bench import Limits
from hil.master.whereabouts import Whereabouts, stop_text, way_out

LIMITS = Limits(torque_nm=1.0, speed_rps=12.0, position_min_rev=-22.0, position_max_rev=22.0)


@pytest.mark.parametrize(
    ("stands", "low", "high", "to"),
    [
        (10.99, 0.0, 15.0, "0"),
        (21.0, -1.0, 2.0, "0"),
        (0.0, -1.0, 25.0, "-3"),
        (-5.0, -30.0, 0.0, "8"),
        (0.0, 0.0, 25.557, "-3.56"),
    ],
)
def test_a_refused_motion_names_the_nearest_start_to_zero_from_which_it_fits(
    stands: float, low: float, high: float, to: str
) -> None:
    said = way_out(2, stands, LIMITS, low, high)
    assert said == f"it is at {stands:g} rev; hil move --axis 2 --to {to} moves it to where the motion fits"
    assert float(to) + low >= -22.0
    assert float(to) + high <= 22.0


def test_a_motion_longer_than_the_limits_names_no_move() -> None:
    assert way_out(2, 1.0, LIMITS, -30.0, 30.0) == "it is at 1 rev, and the motion is longer than the range of -22 … 22 rev"


def test_a_stop_says_where_each_axis_stands_and_brings_back_only_what_is_away() -> None:
    found = [Whereabouts(2, 10.987, 0.0), Whereabouts(3, 4.0, 4.001), Whereabouts(5, None, 0.0)]
    assert stop_text(found) == (
        "axis 2 is at 10.99 rev, axis 3 is at 4 rev, the position of axis 5 is not known; "
        "to bring it back: hil move --axis 2 --to 0; once the bus answers again: hil move --axis 5 --back"
    )
    assert stop_text([]) == ""
    assert stop_text([Whereabouts(2, 0.0, None)]) == "axis 2 is at 0 rev"
    assert stop_text([Whereabouts(2, 1.0, 0.5), Whereabouts(3, 2.0, 1.0)]).endswith(
        "; to bring them back: hil move --axis 2 --to 0.5 and hil move --axis 3 --to 1"
    )
