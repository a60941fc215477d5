"""Learning on drawn robots whose ramps do not reach order 1: what an identification has found of it stays, and is cancelled."""

from pathlib import Path

import pytest

from drive_profiles.files.toml import loads
from hil.bench.bench import Bench
from hil.bench.model import IdentifiedError, load_identified
from hil.experiments.cancellation.learn_run import LearnRequest, learn_on_bus, summary
from hil.robot_tables import TransmissionErrorTable
from plant_emulator.rehearsal.direct import DirectChannel
from plant_emulator.rehearsal.many.one import drawn
from plant_emulator.rehearsal.probes import model_of
from plant_emulator.world import World

AXIS = 2
ERRORS = {"a1_arcsec": 0.3, "phi1_deg": 0.1, "a2_arcsec": 3.0, "phi2_deg": 7.0, "a4_arcsec": 0.08, "phi4_deg": 0.5}
"""Standard errors of an identification that knows order 2 badly."""


@pytest.mark.timeout(300)
def test_learning_keeps_the_order_that_its_ramps_do_not_reach(tmp_path: Path) -> None:
    robot, text = drawn(1, "linear")
    bench, true = loads(text, Bench, "blank bench"), robot.axis[AXIS].ate
    known = model_of(robot, bench, AXIS, true)
    ate = known.axis[AXIS].ate
    assert ate is not None
    known = known.with_part(AXIS, ate.model_copy(update={"standard_error": ERRORS}))
    known.save(tmp_path / "model.toml")
    channel = DirectChannel(World(robot), robot.bus.bitrate)
    asked = LearnRequest((AXIS,), passes=3)
    end = learn_on_bus(bench, asked, tmp_path / "out", tmp_path / "learnt.toml", plant=tmp_path / "model.toml", channel=channel)
    assert end.failure is None
    part = load_identified(tmp_path / "learnt.toml").axis[AXIS].ate
    assert isinstance(part, IdentifiedError)
    values: TransmissionErrorTable = part.values
    assert (values.a1_arcsec, values.phi1_deg) == (true.a1_arcsec, true.phi1_deg)
    assert (part.standard_error["a1_arcsec"], part.standard_error["phi1_deg"]) == (0.3, 0.1)
    assert values.a2_arcsec == pytest.approx(true.a2_arcsec, rel=0.03), "learnt: the passes know it better"
    assert part.standard_error["a2_arcsec"] < 1.0
    assert values.a2_arcsec != true.a2_arcsec
    assert "order 1" in part.note
    assert any("order 1 is kept as it was known" in line for line in summary(end))
    assert 1 in {verdict.part.order for verdict in end.learnt[AXIS].passes[-1].verdicts}, "the passes cancel it too"
    assert end.learnt[AXIS].reduction_fraction > 0.5
