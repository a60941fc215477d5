"""The bench file: where its profiles lie, gains that are as found, and mistakes in it."""

import json
from pathlib import Path

import pytest

from drive_profiles.family.profile import VENDORS, Profile
from drive_profiles.files.toml import FileError
from hil.bench.bench import AS_FOUND, REFERENCE, Bench, load_bench
from hil.errors import NotPossibleError

TEXT = REFERENCE.read_text(encoding="utf-8")
PROFILE = 'profile = "emulated_drive"'
CONTROL = next(line for line in TEXT.splitlines() if line.startswith("control = "))


def written(folder: Path, *changes: tuple[str, str]) -> Path:
    """A bench file with the first of each of these texts replaced."""
    text = TEXT
    for before, after in changes:
        assert before in text
        text = text.replace(before, after, 1)
    (folder / "bench.toml").write_text(text, encoding="utf-8")
    return folder / "bench.toml"


def test_a_relative_path_of_a_profile_counts_from_the_bench_file(tmp_path, monkeypatch):
    folder, elsewhere = tmp_path / "robot", tmp_path / "elsewhere"
    (folder / "drives").mkdir(parents=True)
    elsewhere.mkdir()
    (folder / "drives" / "mine.toml").write_text((VENDORS / "emulated_drive.toml").read_text())
    (folder / "tip.toml").write_text((VENDORS / "emulated_accelerometer.toml").read_text())
    written(folder, (PROFILE, 'profile = "drives/mine.toml"'), ('"emulated_accelerometer"', '"tip.toml"'))
    for place, path in ((elsewhere, folder / "bench.toml"), (folder, Path("bench.toml")), (tmp_path, Path("robot/bench.toml"))):
        monkeypatch.chdir(place)
        bench = load_bench(path)
        assert bench.axis[2].profile == str(folder / "drives" / "mine.toml")
        assert bench.axis[3].profile == "emulated_drive", "a name is one of the package"
        assert Profile.load(bench.axis[2].profile).name == "emulated_drive"
        assert Profile.load(bench.accelerometer.profile).kind == "accelerometer"


def test_an_absolute_path_of_a_profile_stays(tmp_path):
    own = VENDORS / "emulated_drive.toml"
    assert load_bench(written(tmp_path, (PROFILE, f'profile = "{own}"'))).axis[2].profile == str(own)


@pytest.mark.parametrize(
    ("profile", "words"),
    [
        (
            "maxon_epso4",
            r"\.toml:\d+: axis\.2\.profile: no drive profile 'maxon_epso4', did you mean maxon_epos4\? available: copley",
        ),
        ("quite_other", r"no drive profile 'quite_other'; available: copley_plus, .*; drive-profiles list describes them$"),
        ("maxon_epos4/70-99", r"\.toml:\d+: axis\.2\.profile: profile maxon_epos4 has no product '70-99'; it has .*70-15"),
        ("mine/epos.toml", r"axis\.2\.profile: no file 'mine/epos\.toml'; expected a drive profile's path from this folder"),
    ],
)
def test_a_profile_that_there_is_not_is_named_with_file_key_and_those_that_there_are(tmp_path, profile, words):
    with pytest.raises(FileError, match=words):
        load_bench(written(tmp_path, (PROFILE, f'profile = "{profile}"')))


def test_gains_may_be_as_found(tmp_path):
    bench = load_bench(written(tmp_path, (CONTROL, f'control = "{AS_FOUND}"')))
    assert bench.axis[2].control == AS_FOUND
    assert bench.axis[2].loop(250e-6) is None
    assert bench.axis[2].plant() is not None, "the plant is known all the same"
    assert not bench.axis[2].has_loop
    with pytest.raises(NotPossibleError, match='a notch needs gains in the bench file: control = "as found" leaves them'):
        bench.axis[2].gains("a notch")
    assert bench.axis[3].gains("a notch").position_gain_per_s == 25.0
    again = Bench.model_validate_json(json.dumps(bench.model_dump(mode="json")), strict=True)
    assert again == bench, "results hold the whole file"


@pytest.mark.parametrize(
    ("control", "words"),
    [
        ('control = "as fund"', ["axis.2.control: found 'as fund'; expected one of 'as found'"]),
        ("control = 3", ["axis.2.control: found 3; expected a table"]),
        (CONTROL.replace("position_gain_per_s", "position_gain_hz"), ["axis.2.control.position_gain_hz: wrong unit"]),
        ("", ["axis.2.control: is missing; expected a table with position_gain_per_s"]),
    ],
)
def test_a_mistake_in_the_gains_is_told_once(tmp_path, control, words):
    with pytest.raises(FileError) as caught:
        load_bench(written(tmp_path, (CONTROL, control)))
    assert len(caught.value.problems) == len(words)
    assert all(word in str(caught.value) for word in words)


def test_a_lever_in_mm_is_refused_with_its_unit(tmp_path):
    lever = next(line for line in TEXT.splitlines() if line.startswith("tip_lever_m"))
    with pytest.raises(FileError, match=r"780 m is too long for a lever; expected at most 20 m: state it in m, not in mm"):
        load_bench(written(tmp_path, (lever, "tip_lever_m = 780.0")))


def test_a_name_of_the_package_that_is_nearly_right_is_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileError, match=r"refrence: does not exist; expected a bench file; did you mean reference\?"):
        load_bench("refrence")
    with pytest.raises(FileError, match="cannot be read"):
        load_bench("mine.toml")
