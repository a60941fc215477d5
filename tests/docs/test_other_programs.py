"""The example of docs/other-programs.md for the `canopen` package, letter by letter, on the robot that the page serves."""

import pytest

from tests.docs.pages import ROOT, blocks_in, commands_of

PAGE = ROOT / "docs" / "other-programs.md"
LIMIT_S = 120
PATIENT = """
import canopen
from canopen.sdo import SdoClient

SdoClient.RESPONSE_TIMEOUT = 5.0  # the package's own times are for a machine without other work
for name in ("SWITCH_OP_MODE", "SWITCH_STATE_FINAL", "SWITCH_STATE_SINGLE", "CHECK_TPDO"):
    setattr(canopen.BaseNode402, f"TIMEOUT_{name}", 5.0)
exec(compile(open("example.py").read(), "example.py", "exec"))
"""


@pytest.mark.slow
def test_the_example_of_the_canopen_package_enables_and_homes_a_drive(shell):
    [example] = [block.body for block in blocks_in(PAGE) if block.language == "python"]
    serve, sheets = (
        next(command.text for command in commands_of(PAGE) if command.text.startswith(f"plant-emulator {verb}"))
        for verb in ("serve", "eds")
    )
    activate, *_ = commands_of(PAGE)
    assert shell.run(activate.text, LIMIT_S)[0] == 0
    shell.serve(serve, LIMIT_S)
    assert shell.run(sheets, LIMIT_S)[0] == 0
    (shell.folder / "example.py").write_text(shell.local(example), encoding="utf-8")
    (shell.folder / "patient.py").write_text(PATIENT, encoding="utf-8")
    status, said = shell.run("python patient.py", LIMIT_S)
    assert status == 0, said
    assert "homed: True" in said.splitlines(), said
