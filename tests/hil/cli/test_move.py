"""The command `hil move`: what it refuses before it looks at a bus."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from hil.cli.main import app

NOWHERE = "local:/nowhere/x.sock"


def move(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["move", *arguments])
    assert "Traceback" not in result.output
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.stderr


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (("--axis", "2"), 2, "give one of --to and --by"),
        (("--axis", "2", "--to", "0", "--by", "1"), 2, "give one of --to and --by"),
        (("--axis", "2", "--to", "0", "--back"), 2, "give one of --to and --by, in motor revolutions, or --back"),
        (("--axis", "9", "--back"), 3, "has no axis 9; it has 2, 3, 5"),
        (("--axis", "2", "--to", "zero"), 2, "'zero': expected a valid number"),
        (("--axis", "two", "--to", "0"), 2, "'two': expected a valid integer"),
        (("--to", "0"), 2, "--axis"),
        (("--axis", "2", "--to", "1rev"), 2, "'1rev': expected a valid number"),
        (("--axis", "9", "--to", "0"), 3, "has no axis 9; it has 2, 3, 5"),
        (("--axis", "-2", "--to", "0"), 3, "has no axis -2"),
        (
            ("--axis", "2", "--to", "22.01"),
            3,
            "the position of axis 2 would be 22.01 rev; the limit is 22 rev; choose one within -22 … 22",
        ),
        (("--axis", "2", "--to", "-1e9"), 3, "the limit is -22 rev"),
        (("--axis", "2", "--to", "nan"), 2, "'nan': expected a finite number"),
        (("--axis", "2", "--by", "inf"), 2, "'inf': expected a finite number"),
        (("--axis", "2", "--to", "0", "--loop", "tool"), 2, "'tool' is not one of"),
        (("--axis", "2", "--to", "0", "--bus", NOWHERE), 4, "no bus at local:/nowhere/x.sock"),
        (("--axis", "2", "--to", "0", "--bus", "nonsense"), 2, "not a bus address"),
    ],
)
def test_a_wrong_input_is_named_before_anything_moves(arguments: tuple[str, ...], status: int, words: str) -> None:
    code, said = move("--bench", "reference", *(() if "--bus" in arguments else ("--bus", NOWHERE)), *arguments)
    assert code == status, said
    assert words in " ".join(said.split()), said


def test_a_choice_and_a_bench_file_that_are_misspelt_are_told_what_there_is() -> None:
    code, said = move("--axis", "2", "--to", "0", "--bench", "reference", "--loop", "tool")
    assert (code, "Value error" in said) == (2, False)
    code, said = move("--axis", "2", "--to", "0", "--bench", "refrence")
    assert (code, "did you mean reference?" in said) == (3, True)


def test_a_bench_file_that_is_none_is_named(tmp_path: Path) -> None:
    code, said = move("--axis", "2", "--to", "0", "--bench", str(tmp_path / "no.toml"))
    assert (code, "no.toml" in said) == (3, True)


def test_back_without_a_log_of_a_motion_says_where_it_looked_and_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "refused").mkdir()
    (tmp_path / "refused" / "bus.log").write_text("(0.000000) local 582#4364600000000100 R\n", encoding="utf-8")
    code, said = move("--axis", "2", "--back", "--bench", "reference", "--bus", NOWHERE)
    assert code == 3
    assert "no log of a motion of axis 2 in bench-out/*/bus.log and */bus.log" in said
    assert said.endswith("give the command in the folder of the last one, or name a position with --to\n")
