"""`--out`: the files of an earlier command are not replaced unless `--force` says so."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

import hil
from hil.cli.main import app
from hil.errors import NotPossibleError

NOWHERE = ("--bus", "local:/nowhere/x.sock")
COMMANDS = {
    "run": ("run", "line-motion", "--bench", "reference", *NOWHERE),
    "compare": ("compare", "--bench", "reference", *NOWHERE),
    "move": ("move", "--axis", "2", "--to", "0", "--bench", "reference", *NOWHERE),
    "check": ("check", "--bench", "reference", *NOWHERE),
    "learn": ("learn", "--axis", "2", "--model", "{folder}/m.toml", "--bench", "reference", *NOWHERE),
    "learn --motion": ("learn", "--motion", "line-motion", "--model", "{folder}/m.toml", "--bench", "reference", *NOWHERE),
    "identify plant": ("identify", "plant", "--axis", "2", "--bench", "reference", *NOWHERE),
    "identify ate": ("identify", "ate", "--axis", "2", "--bench", "reference", *NOWHERE),
    "identify ate --recording": ("identify", "ate", "--axis", "2", "--recording", "{folder}/none.csv"),
    "identify arm": ("identify", "arm", "--bench", "reference-arm", "--model", "{folder}/none.toml"),
    "design notch": ("design", "notch", "--axis", "2", "--bench", "reference", "--model", "{folder}/none.toml"),
    "demo": ("demo", "--robot", "/nowhere.toml", "--no-tour"),
}
ON_A_BUS = tuple(name for name in COMMANDS if NOWHERE[0] in COMMANDS[name] and name != "learn --motion")  # inertias come first


def called(name: str, folder: Path, *options: str) -> tuple[int, str]:
    words = [word.format(folder=folder) for word in COMMANDS[name]]
    found = CliRunner().invoke(app, [*words, "--out", str(folder / "out"), *options])
    assert isinstance(found.exception, SystemExit), "no traceback"
    return found.exit_code, " ".join(found.stderr.split())


@pytest.mark.parametrize("name", COMMANDS)
def test_a_folder_with_an_older_result_is_refused_with_what_to_do(name: str, tmp_path: Path) -> None:
    older = tmp_path / "out" / "result.json"
    older.parent.mkdir()
    older.write_text("mine")
    code, said = called(name, tmp_path)
    assert code == 3, said
    assert f"{older} already exists, from an earlier command; name another directory, or --force replaces its files" in said
    assert older.read_text() == "mine"


@pytest.mark.parametrize("name", ON_A_BUS)
def test_force_goes_on_in_such_a_folder(name: str, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "check.json").write_text("mine")
    code, said = called(name, tmp_path, "--force")
    assert (code, "no bus at local:/nowhere/x.sock" in said) == (4, True), said


@pytest.mark.parametrize("file", ["check.json", "design.json", "bus.log", "runs/line.csv"])
def test_recordings_logs_and_other_results_are_kept_as_well(file: str, tmp_path: Path) -> None:
    path = tmp_path / file
    path.parent.mkdir(exist_ok=True)
    path.write_text("mine")
    with pytest.raises(NotPossibleError, match="force=True replaces its files"):
        hil.run("reference", "line-motion", bus=NOWHERE[1], out=tmp_path)


def test_a_folder_with_other_files_is_taken(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "bench.toml").write_text("mine")
    assert called("run", tmp_path)[0] == 4
