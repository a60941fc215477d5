"""The verdict on a design."""

from types import SimpleNamespace
from typing import Any

from hil.report.pages.design import verdict


def test_the_reason_for_a_missed_design_is_not_the_headline_again() -> None:
    failure: Any = SimpleNamespace(
        what="the best filters within all margins do not meet the limits of the tip", missed=("tip peak",)
    )
    outcome: Any = SimpleNamespace(failure=failure, is_usable=True, request=SimpleNamespace(is_given=False))
    assert verdict(outcome).details == ("tip peak",)
    failure.what = "no loop is stable"
    assert verdict(outcome).details == ("no loop is stable", "tip peak")
