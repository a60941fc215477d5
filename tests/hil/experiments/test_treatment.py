"""Treatments by name, what each needs, and how runs are repeated and fitted to their bus."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from drive_profiles.address import Address
from hil.bench.bench import load_bench
from hil.bench.design import DesignedAxis, Designs
from hil.bench.model import Identified, IdentifiedError
from hil.control.treatments import treatment
from hil.errors import NotPossibleError
from hil.experiments.bus_demand import check_load
from hil.experiments.motions import LINE_MOTION
from hil.experiments.plan import Experiment, outside
from hil.experiments.runner import mean_of
from hil.experiments.treatment import TITLES, TREATMENTS, Knowledge, treatment_setup
from hil.master.motion import RunResult
from hil.recording import Recording
from hil.robot_tables import TransmissionErrorTable
from tests.hil.results.made import run_entry

BENCH = load_bench("reference")
ERROR = IdentifiedError(values=TransmissionErrorTable(a2_arcsec=4.9, phi2_deg=221.0))
FOUND = Identified(robot="reference").with_part(2, ERROR)
DESIGNED = Designs(
    robot="reference",
    axis={
        2: DesignedAxis(
            notch=(BENCH.axis[3].notch[0],), sensitivity_peak=1.6, phase_margin_deg=36.0, gain_margin_db=15.0, period_s=250e-6
        )
    },
)
KNOWN = Knowledge(identified=FOUND, designs=DESIGNED, learnt=FOUND)


def way(name: Any, knowledge: Knowledge = KNOWN, loop: str = "drive") -> Any:
    return treatment_setup(BENCH, name, knowledge, 250e-6, loop)


def test_every_treatment_has_a_name_and_a_way() -> None:
    assert set(TITLES) == set(TREATMENTS)
    for name in TREATMENTS:
        found = way(name, loop="host" if name == "fixed-notch" else "drive")
        assert found.is_cancelled == (treatment(name).cancels == "set-points")
        assert found.is_inside == (name == "cancellation-inside")


def test_a_designed_filter_takes_the_place_of_the_benchs_own() -> None:
    found = way("notch-designed")
    assert found.bench.axis[2].notch == (BENCH.axis[3].notch[0],)
    assert found.bench.axis[3] == BENCH.axis[3]
    assert found.filters == "notch"


def test_lowered_gains_are_half_of_all_three_and_nothing_else() -> None:
    low, full = way("low-gains").bench.axis[2].control, BENCH.axis[2].control
    assert low.position_gain_per_s == 0.5 * full.position_gain_per_s
    assert low.velocity_gain_nm_s_rad == 0.5 * full.velocity_gain_nm_s_rad
    assert low.velocity_integral_gain_nm_rad == 0.5 * full.velocity_integral_gain_nm_rad
    assert low.lowpass_hz == full.lowpass_hz


def test_a_fixed_notch_stands_where_the_arm_answers_most() -> None:
    found = way("fixed-notch", loop="host")
    loop = BENCH.axis[2].loop(250e-6, 1, with_notch=False)
    assert loop is not None
    grid = np.linspace(5.0, 25.0, 2001)
    depth = np.abs(replace(loop, fixed=(found.fixed[2],)).notch_response(grid, 0.0))
    assert grid[np.argmin(depth)] == pytest.approx(loop.peak_hz(), abs=0.1)
    assert found.fixed.keys() == {2, 3}


@pytest.mark.parametrize(
    ("name", "knowledge", "loop", "words"),
    [
        ("notch-designed", Knowledge(), "drive", "--design"),
        ("cancellation-learnt", Knowledge(), "drive", "--learnt"),
        ("cancellation", KNOWN, "host", "--loop drive"),
        ("cancellation-inside", KNOWN, "host", "--loop drive"),
        ("fixed-notch", KNOWN, "drive", "--loop host"),
        ("notch-designed", Knowledge(designs=DESIGNED.model_copy(update={"robot": "other"})), "drive", "'other'"),
    ],
)
def test_what_is_not_known_or_not_possible_is_said(name: str, knowledge: Knowledge, loop: str, words: str) -> None:
    with pytest.raises(NotPossibleError, match=words):
        way(name, knowledge, loop)


def test_only_what_is_meant_to_keep_the_specification_is_held_against_it() -> None:
    spared = {"none", "low-gains", "fixed-notch", *(name for name in TREATMENTS if name.startswith("shaper-"))}
    runs = [run_entry(name, tip_peak_mm=0.07) for name in TREATMENTS]
    assert {run.treatment for run in outside(runs)} == {*TREATMENTS} - spared
    assert outside([run_entry(name, tip_peak_mm=0.03) for name in TREATMENTS]) == []


# -- what fits on the bus ------------------------------------------------------------------------------------------------


def on(bitrate: int | None) -> Any:
    return cast("Any", SimpleNamespace(address=Address("local", "/tmp/x.sock", bitrate)))  # noqa: S108 - only a name


@pytest.mark.parametrize(
    ("bitrate", "period_s", "name", "shows"),
    [
        (None, 0.001, "notch", True),
        (1_000_000, 0.002, "notch", True),
        (1_000_000, 0.001, "notch", False),
        (1_000_000, 0.001, "cancellation+notch", False),
        (1_000_000, 0.001, "none", False),
    ],
)
def test_what_the_drives_tell_of_their_filters_is_left_out_where_only_that_does_not_fit(
    bitrate: int | None, period_s: float, name: Any, shows: bool
) -> None:
    bench = BENCH.model_copy(update={"bus": BENCH.bus.model_copy(update={"sync_period_s": period_s})})
    experiment = Experiment(LINE_MOTION, None, name)
    assert check_load(bench, on(bitrate), experiment.bus_demand(experiment.motion(bench))) is shows


def test_torque_offsets_take_their_room_on_the_bus() -> None:
    bench = BENCH.model_copy(update={"bus": BENCH.bus.model_copy(update={"sync_period_s": 0.001})})
    experiment = Experiment(LINE_MOTION, None, "none")
    motion = experiment.motion(bench)
    check_load(bench, on(1_000_000), experiment.bus_demand(motion))
    offset = experiment.bus_demand(replace(motion, torque_offset_nm=np.zeros_like(motion.motor_angle_rad)))
    with pytest.raises(NotPossibleError, match=r"does not fit|Does not fit"):
        check_load(bench, on(1_000_000), offset)


def test_what_does_not_fit_even_so_is_refused() -> None:
    bench = BENCH.model_copy(update={"bus": BENCH.bus.model_copy(update={"sync_period_s": 0.001})})
    experiment = Experiment(LINE_MOTION, None, "notch")
    with pytest.raises(NotPossibleError, match=r"does not fit.*--overload|Does not fit.*--overload"):
        check_load(bench, on(500_000), experiment.bus_demand(experiment.motion(bench)))


# -- several runs of one motion ------------------------------------------------------------------------------------------


def test_the_mean_of_several_runs_has_less_noise_and_the_worst_of_their_losses() -> None:
    rng = np.random.default_rng(1)
    time = np.arange(1000) * 1e-3
    true = np.sin(2.0 * np.pi * 12.0 * time)

    def result(missed: int) -> RunResult:
        recording = Recording({"time_s": time, "tip_z_m_s2": true + 0.3 * rng.standard_normal(1000)})
        return RunResult(recording, 1000, missed, 0, 1.0, 1.0, 250e-6, None)

    results = [result(missed) for missed in (0, 3, 1)]
    mean = mean_of(results)
    assert mean.missed_cycles == 3
    np.testing.assert_allclose(mean.recording.time_s, time)
    left = [float(np.std(each.recording.columns["tip_z_m_s2"] - true)) for each in (*results, mean)]
    assert left[3] == pytest.approx(np.mean(left[:3]) / np.sqrt(3.0), rel=0.1)
