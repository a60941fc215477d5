"""The summary of a test tier: what failed, what each stage took, and whether anything of a user's was written."""

import sys

import pytest

from tests import stages

BRANCHES = "slave's branches"
FAILING = "import pytest\n\n\ndef test_good():\n    pass\n\n\ndef test_bad():\n    assert False\n"


@pytest.fixture
def tier(tmp_path, monkeypatch):
    """Run stages of a test's own, in a project of its own, as a tier."""
    monkeypatch.setattr(stages, "ROOT", tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / ".home"))
    (tmp_path / "pytest.ini").write_text("[pytest]\n", encoding="utf-8")

    def run(name, *of_tier, options=()):
        monkeypatch.setattr(stages, "stages", lambda tier, seed: iter(of_tier))
        monkeypatch.setattr(sys, "argv", ["stages", name, *options])
        return stages.main()

    return run


def python(text):
    return (sys.executable, "-c", text)


def test_a_stage_that_fails_stops_no_other_and_the_last_lines_name_what_failed(tier, tmp_path, capsys):
    (tmp_path / "test_one.py").write_text(FAILING, encoding="utf-8")
    first = stages.Stage("linter", python("raise SystemExit(3)"))
    second = stages.tests("tests", *stages.ALONE, "-p", "no:cacheprovider")
    assert tier("everyday", first, second, options=("--since", "0")) == 1
    said = capsys.readouterr().out.splitlines()
    end = said[said.index("FAILED linter ended with 3") :]
    assert end[1] == "FAILED test_one.py::test_bad"
    assert [line.split()[0] for line in end[2:-1]] == ["before", "linter", "tests", "in"]
    assert end[-1] == "1 passed, 1 failed, 0 skipped"


def test_a_tier_that_passes_ends_with_0(tier, tmp_path, capsys):
    (tmp_path / "test_one.py").write_text("def test_good():\n    pass\n", encoding="utf-8")
    assert tier("ci", stages.tests("tests", *stages.ALONE, "-p", "no:cacheprovider")) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "1 passed, 0 failed, 0 skipped"
    assert sorted(path.name for path in tmp_path.iterdir() if path.name != "__pycache__") == ["pytest.ini", "test_one.py"]


@pytest.mark.parametrize("name", ["bench.toml", "new.txt", "design/design.toml"])
def test_a_test_that_writes_beside_a_users_files_fails_the_tier(tier, tmp_path, capsys, name):
    writer = stages.Stage("writer", python(f"import pathlib; pathlib.Path({str(tmp_path / name)!r}).write_text('other')"))
    assert tier("ci", writer) == 1
    assert f"FAILED the tests have written {name}" in capsys.readouterr().out


@pytest.mark.parametrize("name", [".cache/hil/plant.native", ".config/drive-profiles.toml", ".local/share/pip/hil_bench-0.1.whl"])
def test_a_test_that_leaves_a_file_of_ours_below_home_fails_the_tier(tier, capsys, name):
    program = f"from pathlib import Path; path = Path.home() / {name!r}; path.parent.mkdir(parents=True); path.touch()"
    assert tier("ci", stages.Stage("writer", python(program))) == 1
    assert f"FAILED the tests have written ~/{name}" in capsys.readouterr().out


@pytest.mark.parametrize("name", [".cache/matplotlib/fontlist.json", ".config/while.toml"])
def test_what_other_programs_keep_below_home_is_not_the_tests(tier, name):
    program = f"from pathlib import Path; path = Path.home() / {name!r}; path.parent.mkdir(parents=True); path.touch()"
    assert tier("ci", stages.Stage("writer", python(program))) == 0


def test_what_runs_beside_others_begins_with_them_and_ends_before_what_must_be_alone(tier, tmp_path, capfd):
    (tmp_path / "test_one.py").write_text("def test_good():\n    pass\n", encoding="utf-8")
    slow = stages.Stage("slow", python("import time; time.sleep(1); print('slow ends')"), is_beside=True)
    quick = stages.Stage("quick", python("print('quick ends')"))
    alone = stages.Stage("alone", python("print('alone ends')"), is_alone=True)
    assert tier("everyday", slow, quick, alone) == 0
    said = capfd.readouterr().out
    assert said.index("quick ends") < said.index("slow ends") < said.index("alone ends")


def test_the_time_of_what_ran_beside_others_ends_with_itself(tmp_path):
    mark = f"import pathlib, time; mark = pathlib.Path({str(tmp_path / 'mark')!r})\n"
    beside = stages.Stage("beside", python(mark + "mark.touch()"), is_beside=True)
    longer = stages.Stage("longer", python(mark + "while not mark.exists():\n    time.sleep(0.01)\ntime.sleep(1)"))
    seconds = {result.stage.name: result.seconds for result in stages.run_all((beside, longer), tmp_path)}
    assert seconds["beside"] < seconds["longer"]


def test_what_fails_beside_others_is_named(tier, capfd):
    assert tier("everyday", stages.Stage("beside", python("raise SystemExit(3)"), is_beside=True)) == 1
    assert "FAILED beside ended with 3" in capfd.readouterr().out


def test_only_the_whole_tier_draws_new_examples():
    assert not any("random" in word for tier in ("everyday", "ci") for each in stages.stages(tier, 7) for word in each.command)
    drawn = [each.command for each in stages.stages("all", 7) if each.name in {"tests", BRANCHES}]
    assert len(drawn) == 2
    assert all({"--hypothesis-profile=random", "--hypothesis-seed=7"} <= set(each) for each in drawn)


def test_the_whole_tier_runs_the_slaves_tests_once_and_asks_for_all_its_branches():
    commands = {each.name: each.command for each in stages.stages("all", 7)}
    assert all((stages.ROOT / path).exists() for path in stages.SLAVE)
    assert {f"--ignore={path}" for path in stages.SLAVE} <= set(commands["tests"])
    assert {*stages.SLAVE, "--cov-branch", "--cov-fail-under=100"} <= set(commands[BRANCHES])
    assert [name for name, command in commands.items() if set(stages.SLAVE) & set(command)] == [BRANCHES]


def test_a_branch_that_no_test_takes_fails_its_stage_and_leaves_no_file(tier, tmp_path, capsys):
    (tmp_path / "half.py").write_text("def half(x):\n    if x:\n        x = 1\n    return x\n", encoding="utf-8")
    (tmp_path / "test_one.py").write_text("from half import half\n\n\ndef test_one():\n    half(1)\n", encoding="utf-8")
    of_another = [word for word in stages.BRANCHES if not word.startswith("--cov=")]
    assert tier("ci", stages.tests(BRANCHES, *stages.ALONE, "-p", "no:cacheprovider", "--cov=half", *of_another)) == 1
    said = capsys.readouterr().out
    assert f"FAILED {BRANCHES} ended with 1" in said
    assert "have written" not in said
