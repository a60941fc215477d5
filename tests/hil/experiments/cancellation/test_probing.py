"""What probing runs say of each order of each axis: learnt, or left at 0 with its reason."""

import numpy as np
import pytest

from hil.analysis import band_scale
from hil.design.probing import Effects, balanced_signs, effects_of, step_to_nothing
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.probing.learning import SPREAD_ARCSEC, MotionNotLearntError, _Led, _told
from hil.experiments.cancellation.probing.motion import peak_and_rms, settings_of, smoothed, values_by_part
from hil.experiments.cancellation.probing.record import MotionLearning
from hil.master.motion import Motion
from hil.recording import Recording

ROWS, PERIOD_S = 600, 0.002
PARTS = (Part(2, 2), Part(2, 4), Part(3, 2))
RIGHT = {Part(2, 2): 5.0 * np.exp(1j), Part(2, 4): 3.0 * np.exp(2j), Part(3, 2): 10.0 * np.exp(-1j)}


def learning() -> MotionLearning:
    angle = np.zeros((ROWS, 2))
    return MotionLearning(Motion((2, 3), PERIOD_S * np.arange(ROWS), angle, starts_at_home=True), band_scale((6.0, 25.0)), {})


def probed(without: tuple[int, ...] = (), right: dict[Part, complex] = RIGHT) -> Effects:
    """Runs of a robot on which some settings do nothing."""
    rng = np.random.default_rng(4)
    frequency = np.fft.rfftfreq(ROWS, PERIOD_S)
    inside = (frequency >= 6.0) & (frequency <= 25.0)

    def band(count: int) -> np.ndarray:
        shape = (count, 3, len(frequency))
        made = np.fft.irfft(inside * (rng.normal(size=shape) + 1j * rng.normal(size=shape)), ROWS, axis=-1)
        return np.asarray(made / np.std(made))

    effects, own = band(6), 0.3 * band(1)[0]
    effects[list(without)] = 0.0
    settings = np.concatenate([np.zeros((3, 6)), 3.0 * balanced_signs(6)])
    noise = 0.1 * band(len(settings))
    return effects_of(settings, np.tensordot(settings - settings_of(PARTS, right), effects, axes=1) + own + noise)


def led(effects: Effects) -> _Led:
    step = step_to_nothing(effects, spread=SPREAD_ARCSEC)
    return _Led(PARTS, effects, step.settings, step)


def told(effects: Effects, of: MotionLearning) -> dict[Part, complex]:
    return values_by_part(PARTS, _told(of, led(effects)))


def test_orders_that_show_are_told_with_their_values() -> None:
    found = told(probed(), learning())
    for part, value in RIGHT.items():
        assert abs(found[part] - value) < 0.2


@pytest.mark.parametrize("without", [(2, 3), (2,)])
def test_an_order_of_which_not_both_directions_are_seen_is_left_at_nothing(without: tuple[int, ...]) -> None:
    """Its amplitude would follow from the one that is seen; of the other nothing is known but how large errors are."""
    of = learning()
    found = told(probed(without), of)
    assert found[Part(2, 4)] == 0.0
    assert all(abs(found[part] - RIGHT[part]) < 0.2 for part in (Part(2, 2), Part(3, 2)))
    assert of.outcomes[Part(2, 4)].outcome == "not seen"
    assert "left at 0" in of.outcomes[Part(2, 4)].words


def test_an_order_that_is_not_told_from_nothing_is_left_at_nothing() -> None:
    of = learning()
    found = told(probed(right={**RIGHT, Part(2, 4): 0.0}), of)
    assert found[Part(2, 4)] == 0.0
    assert of.outcomes[Part(2, 4)].outcome == "nothing found"
    assert of.outcomes[Part(2, 4)].value == 0.0


def test_where_no_order_is_told_nothing_is_learnt() -> None:
    with pytest.raises(MotionNotLearntError, match="no order is significant"):
        told(probed(right=dict.fromkeys(PARTS, 0.0)), learning())


def order_effects(noise: float, beside: float = 0.0) -> tuple[Recording, np.ndarray, Effects]:
    """What one order does to the tip, as an amplitude that passes a resonance; beside it what is none of its sine."""
    rng, count = np.random.default_rng(3), 700
    angle = 2.0 * np.pi * 5.0 * 0.002 * np.arange(count)
    swell = (1.0 + 0.5j * np.linspace(-1.0, 1.0, count)) * np.exp(-(np.linspace(-1.5, 1.5, count) ** 2))
    wave = swell * np.exp(2j * angle)
    true = np.stack([[wave.real] * 3, [-wave.imag] * 3])
    true = true + beside * np.sin(3.7 * angle)
    settings = np.concatenate([np.zeros((3, 2)), 3.0 * np.tile(balanced_signs(2), (2, 1))])
    rows = np.tensordot(settings, true, axes=1) + noise * rng.normal(size=(len(settings), 3, count))
    return Recording({"axis2_position_rad": angle, "time_s": 0.002 * np.arange(count)}), true, effects_of(settings, rows)


def test_an_order_that_hardly_shows_is_told_from_noise_by_its_own_sine() -> None:
    recording, true, found = order_effects(noise=3.0)
    smooth = smoothed(found, [Part(2, 2)], recording, slice(0, 700))
    before, after = (float(np.sum((each.effects - true) ** 2)) for each in (found, smooth))
    assert after < 0.1 * before
    assert np.all(np.diag(smooth.inverse)[1:] < 0.1 * np.diag(found.inverse)[1:])


def test_what_an_effect_has_beside_its_sine_is_kept_where_it_is_no_noise() -> None:
    recording, true, found = order_effects(noise=0.01, beside=0.3)
    smooth = smoothed(found, [Part(2, 2)], recording, slice(0, 700))
    np.testing.assert_allclose(smooth.effects, true, atol=0.05)


def test_peak_and_root_mean_square_are_of_the_vector() -> None:
    peak, rms = peak_and_rms(np.array([[3.0, 0.0], [4.0, 0.0], [0.0, 1.0]]))
    assert peak == 5.0
    assert rms == pytest.approx(np.sqrt(13.0))
