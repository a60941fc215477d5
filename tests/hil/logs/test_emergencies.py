"""Emergencies in a log: in the maker's words, where the log says whose drive it is."""

from pathlib import Path

import pytest

from drive_profiles.family.profile import Profile
from hil.logs.explain import explain
from hil.logs.opening import open_log

PROFILE = Profile.load("maxon_epos4")
CODE, WORDS = next(iter(PROFILE.fault_texts.items()))
UPLOADED_4 = 0x43


def answer(time_s: float, subindex: int, value: int) -> list[str]:
    """Lines of a read of 1018h of node 2."""
    head = bytes([0x18, 0x10, subindex])[:2].hex() + f"{subindex:02x}"
    return [
        f"({time_s:.6f}) can0 602#40{head}00000000",
        f"({time_s + 1e-4:.6f}) can0 582#{UPLOADED_4:02x}{head}{value.to_bytes(4, 'little').hex()}",
    ]


@pytest.mark.parametrize("vendor", [PROFILE.identity.vendor_id, None])
def test_a_makers_code_is_said_in_its_words_where_its_drive_is_known(tmp_path: Path, vendor: int | None) -> None:
    product = PROFILE.identity.product_code
    known = [] if vendor is None or product is None else [*answer(0.1, 1, vendor), *answer(0.2, 2, product)]
    beats = [f"({0.1 * beat:.6f}) can0 702#05" for beat in range(1, 9)]
    emergency = f"(0.500000) can0 082#{CODE.to_bytes(2, 'little').hex()}010000000000"
    log = tmp_path / "bus.log"
    log.write_text("\n".join(sorted([*known, *beats, emergency])) + "\n")
    said = next(each for each in explain(open_log(log), {}).findings if each.kind == "emergency").words
    assert f"{CODE:04X}h" in said
    assert (WORDS in said) == (vendor is not None), said
