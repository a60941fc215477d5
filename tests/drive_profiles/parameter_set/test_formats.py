"""Parameter sets in the formats of other tools: the same values come back, and nothing is guessed."""

import pytest
from typer.testing import CliRunner

from drive_profiles.cli.main import app
from drive_profiles.errors import FileError, RefusedError
from drive_profiles.family.catalogue import Catalogue
from drive_profiles.family.profile import VENDORS, Profile
from drive_profiles.parameter_set import formats, parameters
from drive_profiles.parameter_set.parameters import Item, ParameterSet
from drive_profiles.standard.units import Scaling

EDS = VENDORS / "emulated_drive.eds"
CATALOGUE = Catalogue(Profile.load("emulated_drive"))
SCALING = Scaling(131072, 2.367)
SET = ParameterSet.model_validate(
    {
        "header": {"profile": "emulated_drive"},
        "tuning": {
            "position_gain_per_s": Item(value=25.0, unit="1/s"),
            "notch_1.mode": Item(value=1),
            "notch_1.zeta_rn": Item(value=0.028),
        },
        "limits": {"torque_limit_nm": Item(value=2.367, unit="N·m"), "following_error_window_rad": Item(value=6.25, unit="rad")},
    }
)
runner = CliRunner()


def meaning(parameter_set):
    return {write.address: write.data for write in parameter_set.writes(CATALOGUE, SCALING)}


@pytest.mark.parametrize("suffix", [".dcf", ".cdcf", ".bin"])
def test_what_goes_out_comes_back_as_the_same_bytes(tmp_path, suffix):
    path = tmp_path / f"set{suffix}"
    formats.write(path, SET.writes(CATALOGUE, SCALING), EDS, node_id=2)
    assert meaning(formats.read(path, CATALOGUE, 2)) == meaning(SET)


def test_a_dcf_keeps_every_other_line_of_its_eds(tmp_path):
    path = tmp_path / "set.dcf"
    formats.write(path, SET.writes(CATALOGUE, SCALING), EDS, node_id=2)
    before, after = EDS.read_text().splitlines(), path.read_text().splitlines()
    assert [line for line in after if not line.startswith("ParameterValue")] == before
    assert sum(line.startswith("ParameterValue") for line in after) == 5


def test_an_eds_without_values_is_no_parameter_set():
    with pytest.raises(RefusedError, match="holds no parameter values"):
        formats.read(EDS, CATALOGUE)


def test_a_dcf_needs_the_eds_that_it_is_made_from_and_other_suffixes_are_refused(tmp_path):
    with pytest.raises(RefusedError, match="--eds"):
        formats.write(tmp_path / "a.dcf", [], None)
    with pytest.raises(RefusedError, match="none of the suffixes"):
        formats.write(tmp_path / "a.csv", [], EDS)


@pytest.mark.parametrize("name", ["a.dcf", "a.cdcf"])
def test_what_would_be_too_long_to_be_read_is_not_written(name, tmp_path, monkeypatch):
    monkeypatch.setattr(parameters, "MAX_BYTES", 40)
    with pytest.raises(RefusedError, match="would be a file of"):
        formats.write(tmp_path / name, SET.writes(CATALOGUE, SCALING), EDS, node_id=2)
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize("data", [b"", b"\1", b"\1\0\0\0", b"\1\0\0\0\0\x21\1\4\0\0\0\0", b"\0\0\0\0x"])
def test_hostile_concise_dcfs_are_refused(tmp_path, data):
    path = tmp_path / "a.cdcf"
    path.write_bytes(data)
    with pytest.raises((RefusedError, FileError)):
        formats.read(path, CATALOGUE)


@pytest.mark.parametrize("name", ["set.xyz", "set.eds", "set"])
def test_convert_writes_no_file_whose_suffix_names_no_format(name, tmp_path):
    """It once wrote a parameter set into `set.xyz`."""
    source, out = tmp_path / "set.toml", tmp_path / "out" / name
    out.parent.mkdir()
    SET.save(source)
    refused = runner.invoke(app, ["convert", str(source), "--out", str(out)])
    assert refused.exit_code == 3
    assert f"{name} has none of the suffixes .toml, .dcf, .cdcf, .bin" in refused.stderr.replace("\n", "")
    assert not out.exists()


@pytest.mark.ci
def test_convert_names_what_it_needs_to_know_of_the_drive_and_never_assumes_it(tmp_path):
    source, out = tmp_path / "set.toml", tmp_path / "set.cdcf"
    SET.save(source)
    refused = runner.invoke(app, ["convert", str(source), "--out", str(out), "--counts-per-rev", "131072"])
    assert refused.exit_code == 3
    assert "--rated-torque-nm" in refused.stderr
    assert "--counts-per-rev" not in refused.stderr
    assert not out.exists()
    arguments = ["--counts-per-rev", "131072", "--rated-torque-nm", "2.367"]
    assert runner.invoke(app, ["convert", str(source), "--out", str(out), *arguments]).exit_code == 0
    assert meaning(formats.read(out, CATALOGUE)) == meaning(SET)
    back = tmp_path / "back.toml"
    assert runner.invoke(app, ["convert", str(out), "--profile", "emulated_drive", "--out", str(back)]).exit_code == 0
    assert meaning(ParameterSet.load(back)) == meaning(SET)
