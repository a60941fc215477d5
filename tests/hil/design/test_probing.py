"""Probing: designs that tell all settings apart, settings that bring rows to nothing, and errors that are as large as said."""

import numpy as np
import pytest

from hil.design.probing import MOST_SETTINGS, autocovariance, balanced_signs, effects_of, step_to_nothing

ROWS, PERIOD_S = 600, 0.002


def band(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Random signals between 6 and 25 Hz."""
    frequency = np.fft.rfftfreq(ROWS, PERIOD_S)
    inside = (frequency >= 6.0) & (frequency <= 25.0)
    spectrum = inside * (rng.normal(size=(*shape, len(frequency))) + 1j * rng.normal(size=(*shape, len(frequency))))
    made = np.fft.irfft(spectrum, ROWS, axis=-1)
    return made / np.std(made)


class World:
    """Rows that answer to settings in a known way, with a content of their own and noise."""

    def __init__(self, seed: int, settings: int, *, own: float = 0.0, noise: float = 0.0) -> None:
        self.rng = np.random.default_rng(seed)
        self.effects = band(self.rng, settings, 2)
        self.right = self.rng.normal(0.0, 4.0, settings)
        self.own, self.noise = own * band(self.rng, 2), noise

    def rows(self, settings: np.ndarray) -> np.ndarray:
        told = np.tensordot(settings - self.right, self.effects, axes=1)
        return told + self.own + self.noise * band(self.rng, 2)

    def probed(self, amplitude: float = 3.0, repeats: int = 3):
        signs = balanced_signs(len(self.right))
        settings = np.concatenate([np.zeros((repeats, signs.shape[1])), amplitude * signs])
        return effects_of(settings, np.stack([self.rows(each) for each in settings]))


@pytest.mark.parametrize("settings", [1, 4, 7, 11, 12, 13, 16, 18, 24, 27, 36, 42, MOST_SETTINGS])
def test_a_design_tells_every_setting_from_every_other(settings: int) -> None:
    signs = balanced_signs(settings)
    runs = len(signs)
    assert set(np.unique(signs)) <= {-1.0, 1.0}
    np.testing.assert_array_equal(signs.T @ signs, runs * np.eye(settings))
    assert settings <= runs <= settings + 8  # not many more runs than it takes
    if settings < runs:
        np.testing.assert_array_equal(signs.sum(axis=0), 0.0)  # and from the level


def test_a_design_that_cannot_be_is_refused() -> None:
    for settings in (0, MOST_SETTINGS + 1):
        with pytest.raises(ValueError, match="settings"):
            balanced_signs(settings)


@pytest.mark.parametrize("settings", [4, 12, 18])
def test_without_noise_the_right_settings_are_found_exactly(settings: int) -> None:
    world = World(1, settings)
    found = step_to_nothing(world.probed())
    np.testing.assert_allclose(found.settings, world.right, atol=1e-6)
    np.testing.assert_allclose(found.seen, 1.0, atol=1e-6)
    assert found.left_rms < 1e-6


@pytest.mark.parametrize(("own", "noise"), [(1.0, 0.0), (0.0, 1.0), (1.0, 0.5)])
def test_standard_errors_are_as_large_as_the_errors(own: float, noise: float) -> None:
    """Of the motion's own content too, which repeats itself in every run: the scatter of repeats alone knows nothing of it."""
    off = []
    for seed in range(40):
        world = World(seed, 8, own=own, noise=noise)
        found = step_to_nothing(world.probed())
        off.append((found.settings - world.right) / np.sqrt(np.diag(found.covariance)))
    assert 0.8 < float(np.sqrt(np.mean(np.square(off)))) < 1.25
    assert abs(float(np.mean(off))) < 0.2


def test_noise_is_what_equal_runs_differ_by() -> None:
    noise = np.mean([World(seed, 4, own=2.0, noise=0.5).probed().noise[:, 0] for seed in range(20)])
    assert noise == pytest.approx(0.25, rel=0.1)


def test_a_setting_that_does_nothing_is_left_at_nothing_and_told() -> None:
    for noise in (0.0, 0.5):
        world = World(5, 8, own=0.5, noise=noise)
        world.effects[3] = 0.0
        found = step_to_nothing(world.probed())
        assert found.seen[3] < 0.1
        assert abs(found.settings[3]) < 0.1
        assert np.min(np.delete(found.seen, 3)) > 0.9
        assert found.directions == 7


def test_two_settings_that_do_the_same_are_told_only_together() -> None:
    world = World(6, 8, noise=0.3)
    world.effects[5] = world.effects[2]
    found = step_to_nothing(world.probed())
    assert found.directions == 7
    np.testing.assert_allclose(found.seen[[2, 5]], 0.5, atol=0.05)
    assert found.settings[2] + found.settings[5] == pytest.approx(world.right[2] + world.right[5], abs=0.3)
    assert found.settings[2] == pytest.approx(found.settings[5], abs=0.1)  # the difference is left at 0


def test_noise_does_not_pull_the_settings_towards_nothing() -> None:
    """Noise in the effects makes them look larger than they are: without allowing for it a twentieth would be missing here."""
    ratios = []
    for seed in range(60):
        world = World(seed, 7, noise=1.9)
        found = step_to_nothing(world.probed(repeats=4))
        ratios.append(float(found.settings @ world.right / (world.right @ world.right)))
    assert float(np.mean(ratios)) == pytest.approx(1.0, abs=0.025)


def test_a_run_with_the_settings_leads_on_from_there() -> None:
    world = World(8, 8, own=0.2)
    probed = world.probed()
    first = step_to_nothing(probed)
    off = first.settings + 1.5
    second = step_to_nothing(probed, world.rows(off))
    np.testing.assert_allclose(off + second.settings, first.settings, atol=1e-6)


def test_runs_that_do_not_tell_settings_or_noise_are_refused() -> None:
    signs = balanced_signs(12)
    with pytest.raises(ValueError, match="add runs without a setting"):
        effects_of(signs, np.zeros((12, 1, ROWS)))
    with pytest.raises(ValueError, match="add runs without a setting"):
        effects_of(np.zeros((9, 2)), np.zeros((9, 1, ROWS)))


def test_a_motion_too_short_for_so_many_unknowns_is_refused() -> None:
    world = World(9, 12, own=1.0)
    probed = world.probed()
    short = type(probed)(probed.level[:1, :60], probed.effects[:, :1, :60], probed.inverse, probed.noise[:1, :60])
    with pytest.raises(ValueError, match="independent samples"):
        step_to_nothing(short)


def test_the_autocovariance_of_white_noise_is_its_variance_at_no_lag() -> None:
    found = autocovariance(np.random.default_rng(1).normal(size=(1, 100_000)))
    assert found[0, 0] == pytest.approx(1.0, abs=0.02)
    assert float(np.max(np.abs(found[0, 1:100]))) < 0.03


def test_with_settings_of_a_known_spread_what_is_hardly_seen_stays_near_nothing() -> None:
    """And the others are as near to the right ones as without; nothing is nearer on average than the likeliest settings."""
    with_it, without = [], []
    for seed in range(30):
        world = World(seed, 8, own=0.5, noise=1.5)
        world.effects[3] *= 0.15
        probed, mattering = world.probed(), world.effects.reshape(8, -1)
        for found, kept in ((step_to_nothing(probed, spread=4.0), with_it), (step_to_nothing(probed), without)):
            kept.append(float(np.sum(((found.settings - world.right) @ mattering) ** 2)))
    assert float(np.mean(with_it)) < float(np.mean(without))


@pytest.mark.ci
@pytest.mark.parametrize(("own", "noise"), [(1.0, 0.0), (0.5, 1.0)])
def test_standard_errors_hold_for_settings_of_a_known_spread_too(own: float, noise: float) -> None:
    """Of what does nothing they are the spread itself."""
    off = []
    for seed in range(40):
        world = World(seed, 8, own=own, noise=noise)
        world.effects[3] = 0.0
        found = step_to_nothing(world.probed(), spread=4.0)
        off.append((found.settings - world.right) / np.sqrt(np.diag(found.covariance)))
        assert np.sqrt(found.covariance[3, 3]) == pytest.approx(4.0, rel=0.1)
    assert 0.75 < float(np.sqrt(np.mean(np.square(off)))) < 1.3


def test_a_setting_that_is_known_before_stays_as_it_is_known() -> None:
    """And one of which as much is known as of the others is found as it is without."""
    world = World(3, 4, own=0.3, noise=0.5)
    probed = world.probed()
    covariance = 16.0 * np.eye(4)
    whole = step_to_nothing(probed, spread=covariance)
    np.testing.assert_allclose(whole.settings, step_to_nothing(probed, spread=4.0).settings, rtol=1e-9)
    covariance[2, 2] = 1e-8
    found = step_to_nothing(probed, spread=covariance)
    assert abs(found.settings[2]) < 1e-3
    assert np.sqrt(found.covariance[2, 2]) < 2e-4
    assert abs(found.settings[0] - world.right[0]) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [0, 2])
def test_two_rounds_know_each_setting_by_the_one_that_shows_it(hidden: int) -> None:
    """The second begins where the first has ended, and is as sure of each as that was."""
    off = []
    for seed in range(40):
        first, second = World(seed, 6, own=0.3, noise=0.5), World(seed + 100, 6, own=0.3, noise=0.5)
        first.effects[hidden] *= 0.02
        second.effects[(hidden + 3) % 6] *= 0.02
        second.right = first.right
        before = step_to_nothing(first.probed(), spread=4.0)
        second.right = first.right - before.settings  # its level is what the first has found
        after = step_to_nothing(second.probed(), spread=before.covariance)
        off.append((before.settings + after.settings - first.right) / np.sqrt(np.diag(after.covariance)))
        assert np.all(np.diag(after.covariance) <= np.diag(before.covariance) * 1.001)
        assert np.sqrt(after.covariance[hidden, hidden]) < 0.5 * np.sqrt(before.covariance[hidden, hidden])
    assert 0.7 < float(np.sqrt(np.mean(np.square(off)))) < 1.4
