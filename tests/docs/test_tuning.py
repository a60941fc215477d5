"""docs/tuning.md followed word for word on robots that nobody has tuned for: drawn by seed, from blank bench files.

Only what the page itself says is other: which robot is served, and where its bench file comes from. A step may refuse, with a
cause, where the page says that it can: then what needs its result is left out, and nothing else.
"""

import json

import pytest

from tests.docs.pages import ROOT, commands_of

PAGE = ROOT / "docs" / "tuning.md"
LIMIT_S = 900
MOTION_ITSELF = (
    "the tip is as quiet as with a perfect gear (0.197 mm), but the trial finds less of that in the motion itself: the untreated "
    "order 1 of 1.3 mm hides it"
)
SEEDS = (
    pytest.param(50_604, marks=[pytest.mark.ci, pytest.mark.part]),
    pytest.param(50_602, marks=pytest.mark.slow),
    pytest.param(50_603, marks=[pytest.mark.slow, pytest.mark.xfail(reason=MOTION_ITSELF, strict=True)]),
)
"""Robots that were kept back until this test: arms of 12.6, 4.5 and 4.8 Hz. 50601, the first, has an f_r of 67 Hz and a SYNC
period of 8 ms, which step 3 refuses, with that cause."""
QUICKLY = {
    "hil design notch": "--quick",
    "hil learn": "--passes 3",
    "hil compare": "--treatment none,cancellation",
}
"""What is added to a command that would take minutes."""
MAY_REFUSE = (
    "hil plan",
    "hil run constant-acceleration --axis 2 --bench",
    "hil identify ate",
    "hil design notch",
    "hil run constant-acceleration --axis 2 --treatment notch-designed",
    "hil run constant-acceleration --axis 2 --treatment cancellation",
    "hil compare",
)
"""Commands that, as the page says, may end with 9 on a robot of which nothing is known."""
DESIGN = "design.toml"
"""What `hil design notch` leaves out where no filter is better than none; the page goes on with step 8 then."""


EXPECTED = {
    "hil plan --bench bench.toml": "Fits",
    "hil identify plant": "f_a, anti-resonance  ",
    "hil identify ate": "A2  ",
    "hil run constant-acceleration --axis 2 --treatment cancellation ": "yes",
}
"""Words that the page promises of a command that ends as it says."""


def typed(text, seed):
    """What the page says to do on a drawn robot: serve its file in place of the reference, and copy its blank bench file."""
    if text.startswith("plant-emulator serve"):
        return text.replace("reference", f"fleet/robot-{seed}.toml")
    return f"cp fleet/bench-{seed}.toml bench.toml" if text.startswith("sed ") else text


def beginning(text, table):
    return next((begin for begin in table if text.startswith(begin)), None)


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("seed", SEEDS)
def test_the_page_quiets_a_robot_that_nobody_has_tuned_for(seed, shell):
    drawn = "plant-emulator fleet --seeds 77 --kind real --out fleet"
    assert drawn in PAGE.read_text(encoding="utf-8")
    is_designed = False
    for command in commands_of(PAGE):
        text = typed(command.text, seed)
        if text.startswith("plant-emulator serve"):
            assert shell.run(drawn.replace("77", str(seed)), LIMIT_S)[0] == 0
            shell.serve(text, LIMIT_S)
            continue
        if not is_designed and not text.startswith("hil design") and (DESIGN in text or "design/" in text):
            if not text.startswith("hil compare"):
                continue
            text = text.replace(f" --design {DESIGN}", "")
        quickly = beginning(text, QUICKLY)
        status, said = shell.run(text + (f" {QUICKLY[quickly]}" if quickly else ""), LIMIT_S)
        allowed = {command.status} if beginning(text, MAY_REFUSE) is None else {0, 9}
        assert status in allowed, f"{PAGE.name}:{command.line}: {text}\nended with {status}:\n{said}"
        assert "Traceback (most recent call last)" not in said, said
        promised = beginning(text, EXPECTED)
        assert promised is None or status != command.status or EXPECTED[promised] in said, f"{PAGE.name}:{command.line}: {said}"
        is_designed = (shell.folder / DESIGN).is_file()
    (cancelled,) = shell.folder.glob("bench-out/*-cancellation/result.json")
    for run in json.loads(cancelled.read_text(encoding="utf-8"))["runs"]:
        left = run["trial"]["remainder"]
        assert run["within_spec"] or left["left_mm"] <= left["asked_mm"], run
