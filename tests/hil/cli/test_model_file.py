"""A model file is looked at before the bus is opened: nothing moves for what could not be kept."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from hil.cli.main import app

COMMANDS = (
    ("identify", "plant", "--axis", "2"),
    ("identify", "ate", "--axis", "2"),
    ("learn", "--axis", "2"),
    ("learn", "--motion", "line-motion"),
)


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("precious", "model.toml:1"),
        ('robot = "another"\n', "is of robot 'another'"),
        (None, "there is no folder"),
    ],
    ids=["no model file", "another robot's", "no folder"],
)
def test_a_model_file_that_cannot_be_used_is_refused_before_the_bus_is_opened(
    tmp_path: Path, words: tuple[str, ...], content: str | None, said: str
) -> None:
    model = tmp_path / "folder" / "model.toml"
    if content is not None:
        model.parent.mkdir()
        model.write_text(content, encoding="utf-8")
    bus = f"local:{tmp_path}/none.sock"
    done = CliRunner().invoke(app, [*words, "--bench", "reference", "--bus", bus, "--model", str(model), "--yes"])
    assert done.exit_code == 3, "the bus would be missing: 4"
    assert said in done.output
    assert model.exists() == (content is not None)
