"""The design file: what goes in comes out, other robots' files are left alone, and a bench takes its filters."""

import pytest

from drive_profiles.files.toml import FileError, loads
from hil.bench.bench import Bench, load_bench
from hil.bench.design import DesignedAxis, Designs, load_designs, notch_table, snippet, update_designs, with_designs
from hil.control.notch import Notch
from hil.errors import NotPossibleError

BENCH = load_bench("reference")
TWO = (
    Notch(mode=2, start_rps=3.08, end_rps=9.2, offset_hz=2.32, zeta_rn=0.084, zeta_rdth=0.332, ramp_rps=0.93),
    Notch(order=4, start_rps=1.56, end_rps=4.83, offset_hz=0.36, zeta_rn=0.0527, zeta_rdth=0.145),
)


def designed(*notches, **changes):
    values = {
        "tip_peak_mm": {"2": 0.0362}, "worst_tip_peak_mm": {"2": 0.038}, "sensitivity_peak": 1.611, "phase_margin_deg": 36.3,
        "gain_margin_db": 16.0, "period_s": 250e-6, "note": 'plant of "model.toml"\x7f',
    }  # fmt: skip
    return DesignedAxis(notch=tuple(notch_table(notch) for notch in notches), **{**values, **changes})


def test_a_file_gives_back_what_was_put_in(tmp_path):
    path = tmp_path / "design.toml"
    update_designs(path, "reference", 3, designed(TWO[0], tip_peak_mm={}))
    written = update_designs(path, "reference", 2, designed(*TWO))
    assert load_designs(path) == written
    assert [table.notch() for table in written.axis[2].notch] == list(TWO)
    again = update_designs(path, "reference", 2, designed(TWO[0]))
    assert len(again.axis[2].notch) == 1
    assert again.axis[3] == written.axis[3]


def test_a_bench_takes_the_filters_and_nothing_else():
    changed = with_designs(BENCH, Designs(robot="reference", axis={2: designed(*TWO)}))
    assert [table.notch() for table in changed.axis[2].notch] == list(TWO)
    assert changed.axis[3] == BENCH.axis[3]
    assert changed.axis[2].control == BENCH.axis[2].control
    assert Bench.model_validate(changed.model_dump()) == changed


def test_the_snippet_is_what_a_bench_file_takes():
    text = "\n".join(snippet(2, tuple(notch_table(notch) for notch in TWO)))
    head = 'robot = "x"\n[axis.2]\nsensitivity_peak = 1.5\nphase_margin_deg = 40.0\ngain_margin_db = 10.0\nperiod_s = 250e-6\n'
    assert [table.notch() for table in loads(head + text, Designs).axis[2].notch] == list(TWO)


def test_another_robots_file_is_left_as_it_is(tmp_path):
    path = tmp_path / "design.toml"
    update_designs(path, "another", 2, designed(*TWO))
    before = path.read_bytes()
    with pytest.raises(NotPossibleError, match="is of robot 'another'; expected 'reference'"):
        update_designs(path, "reference", 2, designed(*TWO))
    assert path.read_bytes() == before
    with pytest.raises(NotPossibleError, match="the design file is of robot 'another'"):
        with_designs(BENCH, load_designs(path))
    with pytest.raises(NotPossibleError, match="axis 6"):
        with_designs(BENCH, Designs(robot="reference", axis={6: designed(*TWO)}))


def test_a_file_that_is_none_says_where(tmp_path):
    path = tmp_path / "design.toml"
    path.write_text('robot = "reference"\n[axis.2]\nsensitivity_peak = -1.0\n')
    with pytest.raises(FileError, match="sensitivity_peak"):
        load_designs(path)
