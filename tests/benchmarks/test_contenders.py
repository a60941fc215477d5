"""The other comparisons of the benchmarks: a contender that finds something else ends each of them."""

import contextlib
import os
from collections.abc import Callable

import canopen
import numpy as np
import pytest

from benchmarks import demo_runs, master_path, node_frames, robustness, sdo, stranger, whole_bench
from benchmarks.measure import DisagreementError
from hil.recording import Recording


@pytest.fixture
def _same_cores_after():
    """A benchmark takes the cores that it wants; the tests after it get theirs back."""
    cores = os.sched_getaffinity(0)
    yield
    os.sched_setaffinity(0, cores)


@pytest.mark.slow
@pytest.mark.usefixtures("_same_cores_after")
def test_a_master_that_sends_another_set_point(monkeypatch):
    monkeypatch.setattr(master_path, "SHARE_S", 1e-3)
    found, path = master_path._contend(2)
    assert found.keys() == {"ours", "stretches", "bare", "together", "canopen", "canopen, free"}
    assert np.ptp(path) > 10  # the laws have had something to do
    assert np.abs(path).max() < 7000  # and were not at their limits
    right = stranger.Master.set_points
    monkeypatch.setattr(stranger.Master, "set_points", lambda self: [right(self)[0], right(self)[1] + 1])
    with pytest.raises(DisagreementError, match=r"canopen.* 2 axes, set-points: its result differs by 1, the bound is 0"):
        master_path._contend(2)


def test_a_node_that_answers_otherwise(monkeypatch):
    monkeypatch.setattr(node_frames, "dictionary", lambda vendor_id: stranger.dictionary(vendor_id + 1))
    with pytest.raises(DisagreementError, match=r"canopen.*bytes of its answers"):
        node_frames.node_frames()


def test_a_node_that_refuses(monkeypatch):
    monkeypatch.setattr(node_frames, "dictionary", lambda vendor_id: canopen.ObjectDictionary())
    with pytest.raises(DisagreementError, match=r"canopen.*bytes of its answers"):
        node_frames.node_frames()


@pytest.mark.slow
def test_a_client_that_reads_another_value(monkeypatch):
    monkeypatch.setattr(sdo, "SHARE_S", 1e-3)
    monkeypatch.setattr(sdo, "dictionary", lambda vendor_id=1: stranger.dictionary(vendor_id + 1))
    with pytest.raises(DisagreementError, match=r"`canopen` client.*differs by 1, the bound is 0"):
        sdo.sdo()


@pytest.mark.slow
def test_processes_that_judge_otherwise(monkeypatch):
    right = robustness.judge_all

    def others(studies, runs, executors):
        """Other plants than those of the first turn."""
        jobs = executors.capacity()
        return [right(studies, runs + jobs, executors)[0][jobs:]]

    monkeypatch.setattr(robustness, "judge_all", others)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    with pytest.raises(DisagreementError, match="2 processes, plants that are judged otherwise"):
        robustness.robustness(2)


def test_recordings_are_apart_by_their_columns_and_by_their_names():
    one = Recording({"time_s": np.arange(3.0), "axis2_position_rad": np.zeros(3)})
    other = Recording({"time_s": np.arange(3.0), "axis2_position_rad": np.array([0.0, 0.0, 1e-6])})
    assert whole_bench._recordings_apart(one, one) == 0.0
    assert whole_bench._recordings_apart(one, other) == 1e-6
    assert whole_bench._recordings_apart(one, Recording({"time_s": np.arange(3.0)})) == np.inf


def test_both_ways_of_a_run_must_record_the_same(monkeypatch):
    def recorded(value: float, keep: Callable[[Recording], object]) -> Callable[[], float]:
        return lambda: keep(Recording({"time_s": np.array([value])})) or 1.0

    monkeypatch.setattr(whole_bench, "in_process", lambda case, keep: recorded(0.0, keep))
    monkeypatch.setattr(whole_bench, "as_processes", lambda case, keep: contextlib.nullcontext(recorded(0.0, keep)))
    assert len(whole_bench.whole_bench(1)) == 6
    monkeypatch.setattr(whole_bench, "as_processes", lambda case, keep: contextlib.nullcontext(recorded(1e-9, keep)))
    with pytest.raises(DisagreementError, match="two processes, 6 axes, host-closed, recording"):
        whole_bench.whole_bench(1)


def test_a_plant_that_goes_another_way_in_the_world(monkeypatch):
    monkeypatch.setattr(demo_runs, "best_of", lambda function: function() or 1.0)
    demo_runs.world()

    class Heavier(demo_runs.Axes):
        def __init__(self, robot: object) -> None:
            super().__init__(robot)
            self.plant["arm_inertia_kg_m2"] *= 1.0 + 1e-9

    monkeypatch.setattr(demo_runs, "Axes", Heavier)
    with pytest.raises(DisagreementError, match=r"world, SYNC every 0\.25 ms"):
        demo_runs.world()
