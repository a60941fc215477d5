"""Which orders of a model are cancelled: any, by the set-points; by a drive those that it has; none that noise may have made."""

import pytest

from hil.bench.bench import load_bench
from hil.bench.model import Identified, IdentifiedError, with_identified
from hil.control.order_keys import amplitude_key
from hil.errors import NotPossibleError
from hil.experiments.cancellation.cancellation import cancellation_for
from hil.experiments.cancellation.inside import inside_models
from hil.robot_tables import TransmissionErrorTable

BENCH = load_bench("reference")


def known(amplitudes: dict[float, float], errors: dict[float, float] | None = None) -> Identified:
    table = TransmissionErrorTable.of(amplitudes, dict.fromkeys(amplitudes, 30.0))
    named = {amplitude_key(order): error for order, error in (errors or {}).items()}
    return Identified(robot=BENCH.name).with_part(2, IdentifiedError(values=table, standard_error=named))


def test_any_order_is_cancelled_by_the_set_points() -> None:
    found = cancellation_for(BENCH, known({0.5: 4.0, 1: 20.0, 2: 5.0, 3: 2.0}), (2,), 0.001)
    assert found.tables[2].orders == (0.5, 1, 2, 3)


def test_an_amplitude_within_noise_is_not_cancelled_and_not_believed() -> None:
    model = known({1: 2.9, 2: 5.0, 4: 3.0}, {1: 1.0, 2: 0.02, 4: 1.0})
    assert cancellation_for(BENCH, model, (2,), 0.001).tables[2].orders == (2, 4)
    believed = with_identified(BENCH, model).axis[2].model
    assert believed is not None
    assert believed.ate.amplitudes_arcsec() == {2: 5.0, 4: 3.0}
    assert believed.ate.phases_deg() == {2: 30.0, 4: 30.0}
    with pytest.raises(NotPossibleError, match="no transmission error"):
        cancellation_for(BENCH, known({2: 1.0}, {2: 0.5}), (2,), 0.001)


def test_a_drive_that_cancels_by_itself_is_asked_for_no_order_that_it_lacks() -> None:
    assert set(inside_models(BENCH, known({1: 20.0, 2: 5.0, 4: 3.0}), (2,))) == {2}
    with pytest.raises(NotPossibleError, match="the drive cancels orders 1, 2, 4 only; the model has order 3"):
        inside_models(BENCH, known({2: 5.0, 3: 2.0}), (2,))
