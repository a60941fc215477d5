"""A DCF, or a concise DCF, wherever a parameter set is taken: real processes, a real local bus, an emulated drive."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from drive_profiles import eds
from drive_profiles.cli.main import app
from drive_profiles.family.profile import VENDORS
from drive_profiles.parameter_set.parameters import ParameterSet
from tests.drive_profiles.cli.test_on_a_bus import serving

EDS = VENDORS / "emulated_drive.eds"
runner = CliRunner()


@pytest.fixture(scope="module")
def robot():
    with serving("--drive", "5=maxon_epos4") as address:
        yield address


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, robot):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HIL_BUS", robot)
    return tmp_path


def run(*arguments, code=0):
    result = runner.invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == code, (arguments, result.output, result.exception)
    return result


@pytest.fixture
def pulled(folder):
    """A set that was pulled, and the DCF made of it, without a word on the encoder."""
    run("pull", "--node", "2", "--eds", EDS, "--out", "a.toml")
    run("convert", "a.toml", "--eds", EDS, "--out", "a.dcf")
    return ParameterSet.load(folder / "a.toml")


@pytest.mark.slow
def test_a_dcf_of_a_pulled_set_says_whose_it_is(pulled, folder):
    description = eds.load(folder / "a.dcf")
    assert (description.own_node_id, description.serial_number) == (2, pulled.header.serial_number)
    assert pulled.header.counts_per_rev == 131072
    assert description.rewrite({}) == (folder / "a.dcf").read_bytes()
    source, made = EDS.read_text().splitlines(), (folder / "a.dcf").read_text().splitlines()
    added = [line for line in made if line not in source]
    kinds = ("ParameterValue=", "; drive-profiles: ", "[DeviceComissioning]", "NodeID=2", "LSS_SerialNumber=", "NrOfEntries")
    assert all(line.startswith(kinds) for line in added)
    assert [line for line in source if line not in made] == []


@pytest.mark.slow
def test_a_set_goes_to_a_dcf_and_back_without_loss(pulled, folder):
    run("convert", "a.dcf", "--out", "b.toml")
    back = ParameterSet.load(folder / "b.toml")
    assert list(back.items()) == [(name, key, item.model_copy(update={"name": i.name}))
                                  for (name, key, item), (_, _, i) in zip(pulled.items(), back.items(), strict=True)]  # fmt: skip
    left_out = {"hash", "not_read"}
    assert back.header.model_dump(exclude=left_out) == pulled.header.model_dump(exclude=left_out)
    for pair in (("a.toml", "a.dcf"), ("a.dcf", "a.toml"), ("a.toml", "b.toml"), ("a.dcf", "a.dcf")):
        assert run("diff", *pair).stdout == "no difference\n"


@pytest.mark.ci
def test_lines_in_units_and_raw_lines_of_the_same_bytes_are_no_difference(pulled, folder):
    run("convert", "a.toml", "--eds", EDS, "--out", "a.cdcf")
    run("convert", "a.cdcf", "--out", "raw.toml", "--profile", "emulated_drive", "--eds", EDS)
    raw = ParameterSet.load(folder / "raw.toml")
    assert any(key.startswith("0x6065") for _, key, _ in raw.items())  # rad: nothing in a concise DCF says how many counts
    for other in ("raw.toml", "a.cdcf"):
        assert run("diff", "a.toml", other).stdout == "no difference\n"
    text = (folder / "raw.toml").read_text()
    line = next(line for line in text.splitlines() if line.startswith('"0x6065:0"'))
    (folder / "raw.toml").write_text(text.replace(line, '"0x6065:0" = { value = 20861, type = "UNSIGNED32" }'))
    shown = run("diff", "a.toml", "raw.toml", code=7).stdout.splitlines()[1:]
    assert len(shown) == 1
    assert shown[0].split() == ["following_error_window_rad", "25.13", "1", "rad"]


@pytest.mark.slow
def test_verify_diff_and_upload_take_a_dcf_and_a_concise_one(pulled, folder):
    run("convert", "a.toml", "--eds", EDS, "--out", "a.cdcf")
    for name in ("a.dcf", "a.cdcf"):
        assert run("verify", name, "--node", "2").stdout == "no difference\n"
        assert run("diff", name, "--node", "2").stdout == "no difference\n"
    text = (folder / "a.toml").read_text()
    old = next(line for line in text.splitlines() if line.startswith('"position_gain_per_s"'))
    (folder / "n.toml").write_text(text.replace(old, '"position_gain_per_s" = { value = 19.5, unit = "1/s" }'))
    run("convert", "n.toml", "--eds", EDS, "--out", "n.dcf")
    assert "position_gain_per_s" in run("verify", "n.dcf", "--node", "2", code=7).stdout
    assert "position_gain_per_s" in run("diff", "a.dcf", "n.dcf", code=7).stdout
    assert "1 written" in run("upload", "n.dcf", "--node", "2", "--yes").stdout
    run("verify", "n.dcf", "--node", "2")
    assert "serial number 2; node 3 has 3" in run("upload", "n.dcf", "--node", "3", "--yes", code=3).stderr
    run("upload", "a.dcf", "--node", "2", "--yes")
    run("verify", "a.toml", "--node", "2")


@pytest.mark.slow
def test_the_doubt_about_a_set_is_not_lost_in_a_dcf(pulled, folder):
    text = (folder / "a.toml").read_text().replace("[header]", '[header]\nunverified = "a forum says so, in °"', 1)
    (folder / "u.toml").write_text(text)
    run("convert", "u.toml", "--eds", EDS, "--out", "u.dcf")
    assert "a forum says so, in °" in run("upload", "u.dcf", "--node", "2", "--yes", code=3).stderr
    # of a DCF that serves as the EDS of another set nothing of the first one's header stays
    run("convert", "a.toml", "--eds", "u.dcf", "--out", "again.dcf")
    assert "forum" not in (folder / "again.dcf").read_text()
    run("verify", "again.dcf", "--node", "2")


@pytest.mark.ci
def test_a_comment_that_is_none_of_ours_is_named(pulled, folder):
    broken = (folder / "a.dcf").read_text().replace("; drive-profiles: counts_per_rev = 131072", "; drive-profiles: counts = 1")
    (folder / "a.dcf").write_text(broken)
    assert "counts" in run("verify", "a.dcf", "--node", "2", code=3).stderr


@pytest.mark.slow
def test_a_vendor_s_eds_becomes_the_dcf_of_one_drive_with_its_commissioning_values(folder):
    source = Path(__file__).parents[4] / "shared" / "eds" / "maxon_EPOS4-Module-50-5.eds"
    if not source.exists():
        pytest.skip(f"no {source}")
    run("pull", "--node", "5", "--out", "e.toml")
    pulled = ParameterSet.load(folder / "e.toml")
    assert pulled.commissioning
    run("convert", "e.toml", "--eds", source, "--out", "e.dcf")
    description = eds.load(folder / "e.dcf")
    assert (description.own_node_id, description.serial_number) == (5, pulled.header.serial_number)
    run("verify", "e.dcf", "--node", "5")
    assert run("diff", "e.toml", "e.dcf").stdout == "no difference\n"
    # the serial number in the DCF says that they are this drive's
    said = run("upload", "e.dcf", "--node", "5", "--yes", "--allow-unverified").stderr
    assert "left out, since the EDS excludes them from downloads (ObjFlags): " in said
    assert "rated_torque" in said
    run("convert", "e.dcf", "--out", "back.toml")
    assert "rated_torque" not in ParameterSet.load(folder / "back.toml").commissioning
    text = (folder / "e.dcf").read_text().replace("LSS_SerialNumber=0x", "LSS_SerialNumber=0x7")
    (folder / "other.dcf").write_text(text)
    refused = run("upload", "other.dcf", "--node", "5", "--yes", "--allow-unverified", code=3).stderr
    assert "the set is for another device" in refused
    assert "commissioning values of another device" in refused
