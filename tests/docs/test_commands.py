"""Each command of the documents runs, as it stands there: one shell a page, in a fresh folder, in the page's order.

What cannot run here is in a table with its reason, and what is shortened or prepared too; a row that no page needs any more is
a fault. An inline command, which has no place in that order, is held to the options that there are.
"""

import importlib
import re
import shlex

import pytest
import typer

from hil.bench.bench import load_bench
from hil.bench.design import DesignedAxis, Designs
from tests.docs import pages
from tests.docs.pages import PAGES, PROGRAMS, ROOT, blocks_in, commands_of, name_of

LIMIT_S = 420
"""Patience with one command, on a machine that has other work."""

SUDO = "changes the network interfaces of the machine"
ADAPTER = "needs a CAN adapter or vcan, and root; tests/vcan does it on a kernel of its own"
DASK = "tests/plant_emulator/rehearsal starts a scheduler and workers itself, on a free port"
POSTURES = "takes nine identifications; tests/bench/test_arm_postures.py and tests/hil/experiments/test_arm_masses.py do parts"
SUITE = "is this test run itself, or another that takes as long"
INSTALLS = "installs what this test runs with"
ARMS = "runs arms, each for a minute: tests/plant_emulator/rehearsal runs one"

NOT_RUN = {
    ("README.md", "make demo"): "installs first; tests/hil/cli runs the demo itself",
    ("docs/conformance.md", "make pytest"): INSTALLS,
    ("docs/testing.md", "make pytest"): INSTALLS,
    ("README.md", "make pytest && pytest tests/conformance"): SUITE,
    ("CONTRIBUTING.md", "make test"): SUITE,
    ("CONTRIBUTING.md", "make test CI=1"): SUITE,
    ("CONTRIBUTING.md", "make test-all"): SUITE,
    ("CONTRIBUTING.md", "make demo"): "installs first; tests/hil/cli runs the demo itself",
    ("CONTRIBUTING.md", "make bench"): "measures for many minutes, and overwrites two pages of docs",
    ("docs/arm-learning.md", "plant-emulator rehearse --arms --seeds 0 --out arms"): ARMS,
    ("docs/arm-learning.md", "plant-emulator rehearse --arms --seeds 1-100 --out arms --resume"): ARMS,
    ("docs/arm-learning.md", "plant-emulator rehearse --summary arms"): ARMS,
    ("docs/arm-identification.md", "hil identify plant --bench reference-arm --axis 2 --model masses.toml"): POSTURES,
    (
        "docs/arm-identification.md",
        "hil identify plant --bench reference-arm --axis 2 --posture-deg 2=44,3=-61,5=-100 --model masses.toml",
    ): POSTURES,
    ("docs/arm-identification.md", "hil identify arm --bench reference-arm --model masses.toml --out masses"): POSTURES,
    ("docs/conformance.md", "pytest tests/conformance --bus socketcan:can0@1M --node 5 --eds device.eds"): ADAPTER,
    ("docs/other-programs.md", "can_viewer -i hil_local -c /tmp/robot.sock"): "draws on a terminal until a key is pressed",
    ("docs/rehearsal.md", "dask scheduler --host 127.0.0.1 --no-dashboard"): DASK,
    ("docs/rehearsal.md", "dask worker tcp://127.0.0.1:8786 --nworkers 4 --nthreads 1 --no-dashboard"): DASK,
    ("docs/rehearsal.md", "plant-emulator rehearse --seeds 1-1000 --on dask:tcp://127.0.0.1:8786 --out rehearsal"): DASK,
    ("docs/socketcan.md", "sudo ip link set can0 type can bitrate 1000000 restart-ms 0"): SUDO,
    ("docs/socketcan.md", "sudo ip link set can0 txqueuelen 64"): SUDO,
    ("docs/socketcan.md", "sudo ip link set can0 up"): SUDO,
    ("docs/socketcan.md", "sudo modprobe vcan echo=1"): SUDO,
    ("docs/socketcan.md", "sudo ip link add vcan0 type vcan && sudo ip link set vcan0 up"): SUDO,
    ("docs/socketcan.md", "plant-emulator serve --bus socketcan:vcan0"): ADAPTER,
    (
        "docs/socketcan.md",
        "hil run constant-acceleration --axis 2 --treatment notch --bench bench.toml --bus socketcan:vcan0",
    ): ADAPTER,
    ("docs/socketcan.md", "make test CI=1"): SUITE,
    ("docs/socketcan.md", "python -m pytest -m vcan tests/vcan"): ADAPTER,
    ("docs/socketcan.md", "python tests/vcan/vm/machine.py -- COMMAND …"): "a virtual machine, which CI starts for tests/vcan",
    ("docs/testing.md", "pytest test_my_robot.py --hil-bench=real.toml --hil-allow-motion --hil-axis 3"): "moves a real robot",
}
"""Commands that do not run here, and why."""

ELSEWHERE = {
    ("README.md", text): "docs/tuning.md"
    for text in (
        "hil identify ate --bench bench.toml --axis 2 --model model.toml",
        "hil run constant-acceleration --axis 2 --treatment cancellation --model model.toml --bench bench.toml",
    )
} | {
    (
        "docs/design.md",
        "hil design notch --bench bench.toml --axis 2 --model model.toml --design design.toml --out design",
    ): "docs/tuning.md",
}
"""Commands that run on another page, where they stand to the letter: they take a minute."""

SHORTENED = {
    (
        "docs/design.md",
        "hil design notch --bench bench.toml --axis 3 --order both --shape trapezoid --phase-margin-deg 40",
    ): "--quick",
    (
        "docs/tuning.md",
        "hil design notch --bench bench.toml --axis 2 --model model.toml --design design.toml --out design",
    ): "--quick",
    (
        "docs/tuning.md",
        "hil compare --bench bench.toml --experiment constant-acceleration --axis 2 --model model.toml --design design.toml",
    ): "--treatment none,notch-designed",
    (
        "docs/tuning.md",
        'hil learn --bench bench.toml --axis 2 --plant model.toml --model learnt.toml --note "22 °C, no load"',
    ): "--passes 3",
    ("docs/arm-learning.md", "hil learn --motion line-motion --bench reference-arm --model learnt.toml"): "--orders 2",
    (
        "docs/arm-learning.md",
        "hil learn --motion line-motion --pace 0.85 --bench reference-arm --model learnt.toml",
    ): "--orders 2",
    ("docs/robustness.md", "plant-emulator robustness --axis 2,3 --out robustness"): "--runs 8",
    ("docs/robustness.md", "plant-emulator robustness --axis 2,3 --treatment none"): "--runs 8",
    ("docs/robustness.md", "plant-emulator robustness --axis 2 --notch design/design.toml"): "--runs 8",
    ("docs/robustness.md", "plant-emulator robustness --axis 2 --spread spread.toml --runs 5000 --seed 7"): "--runs 8",
    ("docs/robustness.md", "plant-emulator robustness --experiment line-motion --runs 300"): "--runs 4",
    (
        "docs/rehearsal.md",
        "python -m plant_emulator.rehearsal.evidence record evidence --kind linear --seeds 40001-40020",
    ): "--seeds 40001",
    ("docs/rehearsal.md", "plant-emulator rehearse --seeds 1-1000 --out rehearsal"): "--seeds 4",
    ("docs/rehearsal.md", "plant-emulator rehearse --seeds 1-1000 --out rehearsal --resume"): "--seeds 4",
}
"""What is added to a command that would take minutes; all else of it stands."""

FOLLOWED = {"docs/real-drive.md": "tests/docs/test_real_drive.py"}
"""Pages whose commands another test types, each from the first to the last: a reader edits a file between them."""

ENDLESS = ("can_logger", "can_bridge", "hil scope")
"""Programs that run until they are interrupted: here after some seconds, with SIGINT as by Ctrl-C."""

BEFORE = {
    "docs/design.md": {"": ["cp hil/bench/reference.toml bench.toml"]},
    "docs/emulated-drive.md": {"": ["cp plant_emulator/robots/reference.toml robot.toml"]},
    "docs/other-programs.md": {
        "can_bridge": [f"plant-emulator serve --bus local:/tmp/{name}.sock --wall" for name in "ab"],
    },
    "docs/first-motion.md": {"hil check": ["cp hil/bench/reference.toml bench.toml"]},  # what the reader has typed
    "docs/planning.md": {"": ["cp hil/bench/reference.toml bench.toml"]},
}
"""What a page takes for granted: typed before the first command that begins so."""

FILES = {
    "docs/python.md": {"ramps.py": "python"},
    "docs/robustness.md": {"spread.toml": "toml"},
    "docs/testing.md": {"test_my_robot.py": "python"},
}
"""Files that a page shows: its first block of that language."""


def designed():
    """A design file as `hil design notch` writes it, with the filter of the reference bench: the search itself takes a minute."""
    [notch] = load_bench("reference").axis[2].notch
    axis = DesignedAxis(notch=(notch,), sensitivity_peak=1.66, phase_margin_deg=35.2, gain_margin_db=19.2, period_s=250e-6)
    return Designs(robot="reference", axis={2: axis})


MADE = {"docs/robustness.md": {"design/design.toml": designed}}
"""Files that a page has from another page's commands."""

SLOW = {
    "docs/arm.md",
    "docs/arm-identification.md",
    "docs/arm-learning.md",
    "docs/explain.md",
    "docs/explain-logs.md",
    "docs/export.md",
    "docs/first-motion.md",
    "docs/live.md",
    "docs/recordings.md",
    "docs/reports.md",
    "docs/load-encoder.md",
    "docs/drive-notch.md",
    "docs/scope.md",
    "docs/serial.md",
    "docs/shapers.md",
    "docs/passport.md",
    "docs/python.md",
    "docs/tuning.md",
    "docs/rehearsal.md",
    "docs/robustness.md",
    "docs/design.md",
    "docs/other-programs.md",
    "docs/testing.md",
}
"""Pages that take longer than a few seconds."""

IN_CI = {"README.md", "docs/emulated-drive.md", "docs/planning.md"}
"""Pages that take seconds; the everyday run takes the others, and CI these as well."""


def marks_of(page):
    return [pytest.mark.slow] if page in SLOW else [pytest.mark.ci] if page in IN_CI else []


COMMANDS = {name_of(path): commands_of(path) for path in PAGES}
WITH_COMMANDS = [path for path in PAGES if COMMANDS[name_of(path)]]


def is_run(command):
    return (command.page, command.text) not in NOT_RUN.keys() | ELSEWHERE.keys()


RUN = [
    name_of(path)
    for path in WITH_COMMANDS
    if name_of(path) not in FOLLOWED and any(is_run(c) and c.text != ". .venv/bin/activate" for c in COMMANDS[name_of(path)])
]


@pytest.mark.parametrize("page", [pytest.param(page, marks=marks_of(page)) for page in RUN])
def test_every_command_of_a_page_runs_as_it_stands_there(page, shell):
    for name, language in FILES.get(page, {}).items():
        first = next(block for block in blocks_in(ROOT / page) if block.language == language)
        (shell.folder / name).write_text(shell.local(first.body), encoding="utf-8")
    for name, made in MADE.get(page, {}).items():
        (shell.folder / name).parent.mkdir()
        made().save(shell.folder / name)
    before = dict(BEFORE.get(page, {}))
    for command in filter(is_run, COMMANDS[page]):
        for begin in [begin for begin in before if command.text.startswith(begin)]:
            for text in before.pop(begin):
                type_in(shell, text, 0, page)
        text = command.text
        if (page, text) in SHORTENED:
            text += " " + SHORTENED[page, text]
        type_in(shell, text, command.status, f"{page}:{command.line}")


def type_in(shell, text, status, where):
    if text.startswith("plant-emulator serve "):
        shell.serve(text, LIMIT_S)
        return
    if text.startswith(ENDLESS):
        # in the foreground: else the program's whole group gets a second SIGINT, which meets it while it ends by the first
        text = f"timeout --foreground --preserve-status --signal=INT 8 {text}"
    ended, said = shell.run(text, LIMIT_S)
    assert ended == status, f"{where}: {text}\nended with {ended} instead of {status}:\n{said}"
    assert "Traceback (most recent call last)" not in said, f"{where}: {text}\n{said}"


def test_a_reader_of_a_page_writes_to_no_file_of_the_project_or_of_its_user(tmp_path, monkeypatch):
    root, folder, place = (tmp_path / name for name in ("root", "folder", "place"))
    for path in (root / "hil", root / "docs", folder, place):
        path.mkdir(parents=True)
    mine = [root / "bench.toml", root / "docs" / "performance.md"]
    for path in mine:
        path.write_text("mine", encoding="utf-8")
    monkeypatch.setattr(pages, "ROOT", root)
    monkeypatch.setattr(pages, "LINKED", ("hil",))
    monkeypatch.setattr(pages, "COPIED", ("docs",))
    with pages.Shell(folder, place) as shell:
        assert shell.run("test -e hil && echo other > bench.toml && echo other > docs/performance.md", LIMIT_S)[0] == 0
    assert [path.read_text(encoding="utf-8") for path in mine] == ["mine", "mine"]


# -- the tables --------------------------------------------------------------------------------------------------------

ON_PAGES = {(command.page, command.text) for commands in COMMANDS.values() for command in commands}


@pytest.mark.parametrize("table", [NOT_RUN, ELSEWHERE, SHORTENED], ids=["not run", "elsewhere", "shortened"])
def test_no_table_speaks_of_a_command_that_is_on_no_page(table):
    assert set(table) - ON_PAGES == set()
    assert all(table.values())


def test_a_command_that_runs_elsewhere_runs_there():
    for (_, text), other in ELSEWHERE.items():
        assert (other, text) in ON_PAGES - NOT_RUN.keys() - ELSEWHERE.keys()


def test_a_page_that_another_test_follows_has_no_row_here():
    for page, test in FOLLOWED.items():
        assert page.removeprefix("docs/") in (ROOT / test).read_text(encoding="utf-8")
        assert page not in {row[0] for table in (NOT_RUN, ELSEWHERE, SHORTENED) for row in table}


def test_no_command_is_in_two_tables():
    assert not NOT_RUN.keys() & ELSEWHERE.keys()
    assert not SHORTENED.keys() & (NOT_RUN.keys() | ELSEWHERE.keys())


def test_what_is_prepared_or_shown_belongs_to_a_page_that_runs():
    assert {*BEFORE, *FILES, *MADE, *SLOW, *IN_CI} <= set(RUN)
    for page, steps in BEFORE.items():
        for begin in steps:
            assert any(command.text.startswith(begin) for command in COMMANDS[page] if is_run(command)), (page, begin)
    for page, files in FILES.items():
        assert set(files.values()) <= {block.language for block in blocks_in(ROOT / page)}


# -- the pages ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_a_block_of_commands_says_that_it_is_one(path):
    """What is not marked `sh` is not run."""
    for block in blocks_in(path):
        if block.language != "sh":
            assert [line for line in block.body.splitlines() if PROGRAMS.match(line)] == [], f"{path}:{block.line}"


@pytest.mark.parametrize("path", WITH_COMMANDS, ids=name_of)
def test_a_page_says_once_where_its_commands_are_found(path):
    text = path.read_text(encoding="utf-8")
    of_ours = [command for command in commands_of(path) if not command.text.startswith(("make", "sudo"))]
    assert len(re.findall(r"\.venv/bin/\S+", text)) == text.count(". .venv/bin/activate") == bool(of_ours)


@pytest.mark.parametrize("path", WITH_COMMANDS, ids=name_of)
def test_a_page_that_types_pytest_has_it_installed_first(path):
    typed = [command.text for command in commands_of(path)]
    first = next((at for at, text in enumerate(typed) if text.startswith(("pytest", "python -m pytest"))), None)
    assert first is None or any(text.startswith(("make pytest", "make test")) for text in typed[:first])


TOOLS = {"hil": "hil.cli.main", "drive-profiles": "drive_profiles.cli.main", "plant-emulator": "plant_emulator.cli.main"}
INLINE = re.compile(r"`((?:hil|drive-profiles|plant-emulator) [a-z-][^`\n]+)`")


@pytest.mark.ci
@pytest.mark.parametrize("path", [path for path in PAGES if "drives" not in path.parts], ids=name_of)
def test_a_command_within_a_sentence_names_only_commands_and_options_that_exist(path):
    unknown = []
    text = re.sub(r"^ *```.*?^ *```$", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    for inline in INLINE.findall(text):
        try:
            words = shlex.split(inline.replace("…", " "))
        except ValueError:
            words = inline.split()
        command = typer.main.get_command(importlib.import_module(TOOLS[words[0]]).app)
        for word in words[1:]:
            below = getattr(command, "commands", None)
            if below is None or word not in below:
                break
            command = below[word]
        else:
            word = None
        options = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)} | {"--help"}
        given = {word.partition("=")[0] for word in words if re.fullmatch(r"--[a-z][\w-]*(=.*)?", word)}
        unknown += [(inline, option) for option in sorted(given - options)]
        if hasattr(command, "commands") and word is not None and not word.startswith("-"):
            unknown.append((inline, word))
    assert unknown == []
