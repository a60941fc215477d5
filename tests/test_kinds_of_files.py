"""A TOML file of another kind than the one asked for: one line says which it is."""

import importlib

import pytest

from drive_profiles.cli import main as profiles
from drive_profiles.errors import FileError
from drive_profiles.files.toml import KINDS, load
from hil.cli import main as bench
from plant_emulator.cli import main as emulator

FILES = {
    "a bench file": "hil/bench/reference.toml",
    "a robot file": "plant_emulator/robots/reference.toml",
    "a drive profile": "drive_profiles/vendors/maxon_epos2.toml",
}
TEXTS = {
    "a model file": 'robot = "r"\n[axis.2.plant]\nantiresonance_hz = 1.0\n',
    "a design file": 'robot = "r"\n[axis.2]\nsensitivity_peak = 1.5\n',
    "a file of faults": '[[fault]]\nkind = "drop"\n',
    "a layout of a recording": '[column]\ntime = "t"\n',
    "a spread of plants": "gear_stiffness_percent = 5.0\n",
    "a parameter set": '[tuning]\n"0x2200:1" = { value = 7, type = "UNSIGNED16" }\n',
}
MODELS = {name: path for tool in (bench, emulator, profiles) for name, path in tool.SCHEMAS.items()}
EXPECTED = {
    "bench": "a bench file",
    "model": "a model file",
    "design": "a design file",
    "layout": "a layout of a recording",
    "robot": "a robot file",
    "spread": "a spread of plants",
    "faults": "a file of faults",
    "profile": "a drive profile",
    "parameters": "a parameter set",
}


def model(name):
    module, _, attribute = MODELS[name].partition(":")
    found = getattr(importlib.import_module(module), attribute)
    return found if isinstance(found, type) else found.__args__[1]


@pytest.fixture
def file(request, tmp_path):
    """The file of a kind: one of the project's, or the shortest with its mark."""
    if request.param in FILES:
        return request.config.rootpath / FILES[request.param]
    path = tmp_path / "some.toml"
    path.write_text(TEXTS[request.param])
    return path


@pytest.mark.parametrize(("file", "kind"), [(kind, kind) for kind in KINDS], indirect=["file"])
@pytest.mark.parametrize("name", EXPECTED)
def test_a_file_of_another_kind_is_refused_in_one_line_with_both_kinds(file, kind, name):
    if EXPECTED[name] == kind:
        return
    with pytest.raises(FileError) as caught:
        load(file, model(name))
    assert str(caught.value) == f"{file}: is {kind}; expected {EXPECTED[name]}"


def test_every_kind_with_a_schema_is_told_apart_but_the_tuning_which_other_files_may_be():
    assert set(EXPECTED) == MODELS.keys() - {"tuning"}
    assert set(EXPECTED.values()) == set(KINDS)


def test_a_wrong_key_in_a_file_of_the_right_kind_is_still_named(tmp_path):
    path = tmp_path / "bench.toml"
    path.write_text('[bus]\nsync_period_s = 0.002\n[axis.2]\ntorque_limit_nm = 3.0\n[axis.2.limits]\ntorque_nm = "3"\n')
    with pytest.raises(FileError, match="torque_limit_nm"):
        load(path, model("bench"))
