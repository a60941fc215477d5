"""The shell completes what a user would have to look up: commands, options, profiles, objects, axes, nodes, robots; and files."""

import importlib
import os
import pty
import select
import shutil
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from drive_profiles.cli.completion import complete_objects, joined
from drive_profiles.family.profile import VENDORS, Profile, available
from tests.drive_profiles.profiles import PRODUCTS

PROJECT = Path(__file__).parents[1]
PACKAGES = {"hil": "hil", "drive-profiles": "drive_profiles", "plant-emulator": "plant_emulator"}
BENCH = PROJECT / "hil" / "bench" / "reference.toml"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "bench.toml").write_text(BENCH.read_text(encoding="utf-8").replace("[axis.5]", "[axis.7]"))
    (tmp_path / "maxon_mine.toml").write_text("name = 1\n")
    (tmp_path / "broken.toml").write_text("[axis\n")
    os.mkfifo(tmp_path / "pipe.toml")
    return tmp_path


def asked(words, shell="bash"):
    """What the environment of a tool holds that a shell's script asks for offers."""
    variable = f"_{words[0].upper().replace('-', '_')}_COMPLETE"
    return {
        variable: f"complete_{shell}", "COMP_WORDS": "\n".join(words), "COMP_CWORD": str(len(words) - 1),
        "_TYPER_COMPLETE_ARGS": " ".join(words),
    }  # fmt: skip


def entry_point(tool):
    return importlib.import_module(f"{PACKAGES[tool]}.__main__").main


@pytest.fixture
def offered(folder, monkeypatch, capfd):
    """Gives what a tool offers for the last of some words; by its entry point, in this process and in the folder."""

    def ask(*words, shell="bash"):
        main = entry_point(words[0])
        with monkeypatch.context() as here:
            here.chdir(folder)
            here.setattr(sys, "argv", [words[0]])
            here.setitem(sys.modules, "__main__", ModuleType("__main__"))  # a tool has its name from there
            here.setattr(sys, "meta_path", [*sys.meta_path])  # a tool postpones what it may not need
            for name, value in asked(words, shell).items():
                here.setenv(name, value)
            with pytest.raises(SystemExit) as left:
                main()
        shown = capfd.readouterr()
        assert left.value.code in {None, 0}, shown.err
        assert shown.err == ""
        return shown.out.split()

    return ask


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (("hil", "r"), ["run", "report"]),
        (("hil", "identify", ""), ["plant", "ate", "arm"]),
        (("hil", "run", "l"), ["line-motion"]),
        (("hil", "run", "--treatment", "no"), ["none", "notch", "notch-designed"]),
        (("hil", "run", "--bench", "ref"), ["reference", "reference-arm"]),
        (("hil", "run", "--bench", "reference-arm", "--axis", ""), ["1", "2", "3", "4", "5", "6"]),
        (("hil", "run", "--bench", "reference", "--axis", ""), ["2", "3", "5"]),
        (("hil", "learn", "--bench", "bench.toml", "--axis", ""), ["2", "3", "7"]),
        (("hil", "plan", "--bench", "bench.toml", "--axes", "3,"), ["3,2", "3,7"]),
        (("hil", "compare", "--treatment", "notch,no"), ["notch,none", "notch,notch-designed"]),
        (("drive-profiles", "eds", "c"), ["check", "convert"]),
        (("drive-profiles", "show", "maxon"), ["maxon_epos2", "maxon_epos4", "maxon_mine.toml"]),
        (
            ("drive-profiles", "show", "maxon_epos4/"),
            [f"maxon_epos4/{name}" for name in ("70-15", "module-24-1.5", "module-50-5")],
        ),
        (("drive-profiles", "pull", "--profile", "trinamic_tmcm16xx/tmcm-167"), ["trinamic_tmcm16xx/tmcm-1670"]),
        (("drive-profiles", "pull", "--profile", "elmo_gold/"), []),
        (("drive-profiles", "show", "maxon_epos4/7"), ["maxon_epos4/70-15"]),
        (("drive-profiles", "pull", "--classes", "tuning,lim"), ["tuning,limits"]),
        (("drive-profiles", "get", "--node", ""), ["16", "2", "3", "5"]),
        (("drive-profiles", "get", "status"), ["status_word"]),
        (("drive-profiles", "get", "--profile", "emulated_accelerometer", "604"), ["6040:0", "6041:0"]),
        (("drive-profiles", "set", "--profile", "emulated_drive", "notch_1.zeta_rn"), ["notch_1.zeta_rn="]),
        (("plant-emulator", "serve", "--robot", "bench.toml", "--drive", ""), ["2=", "3=", "7="]),
        (("plant-emulator", "serve", "--drive", "2", "=", "maxon"), ["maxon_epos2", "maxon_epos4"]),
        (("plant-emulator", "serve", "--drive", "=", "2", "=", "elmo"), ["elmo_gold"]),
        (("plant-emulator", "robustness", "--axis", "2,"), ["2,3", "2,5"]),
        (("plant-emulator", "serve", "--framing", ""), ["line", "binary"]),
    ],
    ids=" ".join,
)
def test_a_tool_offers(words, wanted, offered):
    assert sorted(offered(*words)) == sorted(wanted)


@pytest.mark.ci
@pytest.mark.parametrize(
    "words",
    [("hil", "run", "--model", "b"), ("hil", "run", "--bench", "b"), ("drive-profiles", "upload", "b"), ("hil", "report", "")],
    ids=" ".join,
)
def test_where_a_file_is_wanted_the_shell_completes_it(words, offered):
    assert offered(*words) == []


@pytest.mark.slow
@pytest.mark.parametrize("file", ["broken.toml", "pipe.toml", "absent.toml"])
def test_a_file_that_cannot_be_read_offers_nothing_and_says_nothing(file, offered):
    assert offered("hil", "run", "--bench", file, "--axis", "") == []
    assert offered("drive-profiles", "get", "--profile", file, "--eds", file, "30") == []


def test_the_objects_of_an_eds_are_offered_by_address(folder, offered):
    shutil.copy(VENDORS / "emulated_drive.eds", folder / "drive.eds")
    words = ("drive-profiles", "get", "--profile", "emulated_accelerometer")
    assert offered(*words, "1A00") == []
    assert "1A00:1" in offered(*words, "--eds", "drive.eds", "1A00")
    assert "1" in offered(*words, "--eds", "drive.eds", "1A00", ":", "")


@pytest.mark.parametrize("profile", [*available(), *PRODUCTS])
def test_every_parameter_of_a_profile_is_offered_by_name_and_by_address(profile):
    context = SimpleNamespace(params={"profile": profile})
    parameters = Profile.load(profile).parameters
    assert set(parameters) <= set(complete_objects(context, ""))
    assert {f"0x{each.written_address}" for each in parameters.values()} <= set(complete_objects(context, "0x"))


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_ask_in_their_own_way(shell, offered, monkeypatch):
    monkeypatch.setenv("_TYPER_COMPLETE_FISH_ACTION", "get-args")
    assert "maxon_epos4" in " ".join(offered("drive-profiles", "show", "max", shell=shell))


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("hil", "run", "--bench", "reference", "--axis", ""),
        ("drive-profiles", "get", "notch"),
        ("plant-emulator", "serve", "--drive", "2", "=", "m"),
    ],
    ids=" ".join,
)
def test_the_process_that_a_shell_starts_offers_the_same_and_waits_for_no_numbers(words, folder, offered):
    code = (
        f"import sys; sys.argv = [{words[0]!r}]; from {PACKAGES[words[0]]}.__main__ import main\n"
        "try: main()\nexcept SystemExit as left: assert not left.code\n"
        "print(sorted({'numpy', 'scipy', 'cffi', 'matplotlib', 'canopen', 'can', 'rich'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | asked(words), cwd=folder, capture_output=True, text=True, check=True,
        timeout=60,
    )  # fmt: skip
    *offers, loaded = done.stdout.splitlines()
    assert offers == offered(*words)
    assert offers
    assert loaded == "[]"
    assert done.stderr == ""


@pytest.mark.parametrize(
    ("words", "current", "wanted"),
    [
        (["hil", "r"], 1, (["hil", "r"], 1, "")),
        (["hil", ""], 1, (["hil", ""], 1, "")),
        (["t", "--drive", "2", "=", "m", "x"], 4, (["t", "--drive", "2=m"], 2, "2=")),
        (["t", "--drive", "2", "="], 3, (["t", "--drive", "2="], 2, "2=")),
        (["t", "--drive", "=", "2", "=", "m"], 5, (["t", "--drive=2=m"], 1, "--drive=2=")),
        (["t", "--bus", "local", ":", "/x", "--node", ""], 6, (["t", "--bus", "local:/x", "--node", ""], 4, "")),
        (["t", "2=m"], 1, (["t", "2=m"], 1, "")),  # of a user whose COMP_WORDBREAKS is shorter
    ],
)
def test_what_bash_has_parted_is_joined(words, current, wanted):
    assert joined(words, current) == wanted


# -- a real bash --------------------------------------------------------------------------------------------------------


class Terminal:
    """A bash on a terminal, as a user has it."""

    def __init__(self, where):
        self.master, slave = pty.openpty()
        environment = {
            "PATH": f"{Path(sys.executable).parent}:/usr/bin:/bin", "HOME": str(where), "TERM": "dumb", "PS1": "READY>",
        }  # fmt: skip
        command = [shutil.which("bash"), "--norc", "--noprofile", "-i"]
        self.process = subprocess.Popen(
            command, stdin=slave, stdout=slave, stderr=slave, cwd=where, env=environment, start_new_session=True
        )
        os.close(slave)

    def type(self, text, until):
        """Type this, and return what the terminal shows when the wanted text has come."""
        os.write(self.master, text.encode())
        shown, end = "", time.monotonic() + 60.0
        while until not in shown and time.monotonic() < end:
            if select.select([self.master], [], [], 0.2)[0]:
                shown += os.read(self.master, 4096).decode(errors="replace")
        assert until in shown, shown
        return shown

    def close(self):
        self.process.kill()
        self.process.wait()
        os.close(self.master)


@pytest.fixture
def terminal(folder):
    if shutil.which("bash") is None or not (Path(sys.executable).parent / "hil").exists():
        pytest.skip("no bash, or the tools are not installed beside this Python")
    bash = Terminal(folder)
    yield bash
    bash.close()


@pytest.mark.slow
def test_a_real_bash_completes_names_values_and_files(terminal):
    for tool in PACKAGES:
        terminal.type(f'eval "$({tool} --show-completion)"; echo loaded-{len(tool)}\n', until=f"\r\nloaded-{len(tool)}")
    terminal.type("drive-profiles show nov\t", until="novanta_eve ")
    terminal.type("\x15plant-emulator serve --drive 2=elm\t", until="2=elmo_gold ")
    terminal.type("\x15hil run --bench ben\t", until="bench.toml ")
    terminal.type("--axis 7\t --treat\t", until="--treatment ")
    terminal.type("\x15drive-profiles get 0x6041\t", until="0x6041:0 ")
