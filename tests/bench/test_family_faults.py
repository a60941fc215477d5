"""The faults of the matrix on drives of every family: whatever a family does not hold itself, it ends without torque."""

import pytest

from plant_emulator.rehearsal.families.made import vendor_families
from tests.bench.fault_rig import Rig, check_the_end, cycle_of
from tests.bench.test_fault_matrix import CASES, Case

SMOKE = {("harmonic_drive_yukondrive", "09"), ("kollmorgen_akd", "04")}
"""The master is frozen, and a drive that holds no limit itself is not heard any more."""


def cells() -> list[object]:
    """Every family with every fault, while the axes move."""
    return [
        pytest.param(family, case, marks=pytest.mark.ci if (family, case.name[:2]) in SMOKE else pytest.mark.slow,
                     id=f"{family}-{case.name}")
        for family in vendor_families()
        for case in CASES
    ]  # fmt: skip


@pytest.mark.parametrize(("family", "case"), cells())
def test_a_fault_stops_the_family_or_changes_nothing_and_leaves_no_torque(family: str, case: Case) -> None:
    at = cycle_of("constant", case.bitrate, family)
    faults = None if case.faults is None else case.faults(at, family)
    rig = Rig(bitrate=case.bitrate, faults=faults, at=at, act=case.act, family=family)
    outcome = rig.run()
    assert outcome.error is None
    if case.within is not None and "constant" not in case.loose:
        assert outcome.stopped is not None, "the master does not go on"
    if case.name.startswith("14 bus lost"):
        rig.pass_time(1.0)
        rig.channel.lost = False
    check_the_end(rig, outcome)
