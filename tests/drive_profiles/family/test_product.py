"""Products of a family: which one a device is, and what is other in it than in the first one."""

import json

import pytest

from drive_profiles.errors import FileError, ProfileNotFoundError, UnknownProductError
from drive_profiles.family.identity import Firmware
from drive_profiles.family.parameter import Parameter
from drive_profiles.family.product import ParameterChange, Product
from drive_profiles.family.profile import VENDORS, Profile, is_name
from drive_profiles.files import toml as files
from tests.drive_profiles.profiles import PROFILES

FAMILY = """
name = "pair"
title = "Pair"
kind = "accelerometer"
quirks = ["All of them are blue."]
[identity]
vendor_id = 0x1234
product = "small"
product_code = 1
device_type = 0x0002_0192
source = "a manual"
evidence = "documentation"
[sync]
source = "a manual"
evidence = "documentation"
[store]
object = "1010:1"
source = "a manual"
evidence = "documentation"
[parameters.level]
index = 0x2000
subindex = 0
data_type = "UNSIGNED16"
class = "tuning"
maximum = 9.0
default = 4
description = "d"
source = "a manual"
evidence = "documentation"
[parameters.guess]
index = 0x2001
subindex = 0
data_type = "UNSIGNED16"
class = "tuning"
description = "d"
source = "hearsay"
evidence = "unverified"
[[product]]
name = "large"
title = "The large one"
product_code = 2
device_type = 0x0006_0192
source = "another manual"
evidence = "eds"
"""


def family(more: str = "") -> Profile:
    return files.loads(FAMILY + more, Profile)


def parameter(name: str, **keys: object) -> str:
    return f"[product.parameters]\n{name} = {{ {', '.join(f'{key} = {json.dumps(value)}' for key, value in keys.items())} }}\n"


# -- which one it is ---------------------------------------------------------------------------------------------------


def test_a_device_is_the_product_of_its_code():
    pair = family()
    assert [pair.product(code).label for code in (1, 2)] == ["pair/small", "pair/large"]
    assert pair.label == "pair"
    large = pair.product(2)
    assert (large.title, large.identity.device_type, large.identity.vendor_id) == ("The large one", 0x60192, 0x1234)
    assert (large.identity.source, large.identity.evidence) == ("another manual", "eds")
    assert pair.product(1).parameters == pair.parameters
    assert large.product(2) == large
    with pytest.raises(UnknownProductError, match=r"1018h:2\) is 0x1, profile pair/large says 0x2"):
        large.product(1)


@pytest.mark.parametrize("code", [0, 3, None])
def test_a_product_that_is_not_named_is_refused_with_those_that_are(code):
    with pytest.raises(UnknownProductError) as error:
        family().product(code)
    held = "not given" if code is None else f"0x{code:X}"
    assert str(error.value) == f"its product (1018h:2) is {held}, profile pair says 0x1 (small) or 0x2 (large)"


def test_firmware_is_told_apart_by_the_revision():
    old = 'max_revision = 5\n[[product]]\nname = "new"\ntitle = "N"\nproduct_code = 2\nmin_revision = 8\n'
    old += 'source = "s"\nevidence = "eds"\n'
    pair = family(old)
    assert [pair.product(2, revision).label for revision in (0, 5, 8, 2**32 - 1)] == ["pair/large"] * 2 + ["pair/new"] * 2
    for revision in (6, 7):
        with pytest.raises(
            UnknownProductError, match=rf"0x2 of revision 0x0000000{revision}, .*\(large, revision up to 0x00000005\)"
        ):
            pair.product(2, revision)
    with pytest.raises(UnknownProductError, match=r"0x2 \(new, revision from 0x00000008\)"):
        pair.product(2)  # it does not say which it is
    assert pair.product(1, 7).label == "pair/small"


def test_the_first_product_is_what_remains_for_other_firmware():
    pair = files.loads(FAMILY.replace("product_code = 2", "product_code = 1\nmax_revision = 5"), Profile)
    assert [pair.product(1, revision).label for revision in (5, 6, None)] == ["pair/large", "pair/small", "pair/small"]


def test_products_without_a_code_are_candidates_where_no_code_fits():
    text = FAMILY.replace("product_code = 1\n", "").replace("product_code = 2\n", "")
    pair = files.loads(text, Profile)
    assert [each.label for each in pair.candidates(7)] == ["pair/small", "pair/large"]
    assert pair.product(7).label == "pair/small"
    assert pair.products_in_words == ["any product (small)", "any product (large)"]
    one_coded = files.loads(FAMILY.replace("product_code = 1\n", ""), Profile)
    assert [each.label for each in one_coded.candidates(2)] == ["pair/large"]
    assert [each.label for each in one_coded.candidates(3)] == ["pair/small"]


def test_a_family_of_one_product_is_that_product():
    drive = PROFILES["emulated_drive"]
    assert drive.members == (drive,)
    assert drive.product(0x402, 99) == drive
    assert drive.label == "emulated_drive"
    with pytest.raises(UnknownProductError, match="is 0x403, profile emulated_drive says 0x402"):
        drive.product(0x403)


@pytest.mark.parametrize(
    ("first", "second", "common"),
    [((None, 5), (6, None), False), ((None, 5), (5, None), True), ((3, 4), (1, 9), True), ((None, None), (7, 7), True)],
)
def test_ranges_of_firmware_that_have_one_in_common(first, second, common):
    a, b = (Firmware(product_code=1, min_revision=low, max_revision=high) for low, high in (first, second))
    assert a.overlaps(b) == b.overlaps(a) == common
    assert not a.overlaps(b.model_copy(update={"product_code": 2}))


# -- how it is named ---------------------------------------------------------------------------------------------------


def test_a_product_is_loaded_by_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pair.toml").write_text(FAMILY)
    assert Profile.load("trinamic_tmcm16xx/TMCM-1670") == PROFILES["trinamic_tmcm16xx"].product(0x686)
    assert Profile.load("trinamic_tmcm16xx/tmcm-1617").identity.product_code == 0x651
    assert Profile.load("pair.toml/large") == Profile.load(f"{tmp_path}/pair.toml/large") == family().product(2)
    with pytest.raises(UnknownProductError, match=r"maxon_epos4 has no product '50-4'; it has 0x61500000 \(module-50-5\)"):
        Profile.load("maxon_epos4/50-4")
    with pytest.raises(UnknownProductError):
        Profile.load("emulated_drive/emulated_drive")
    for text in ("maxon", "maxon/70-15"):
        with pytest.raises(ProfileNotFoundError, match=r"no drive profile 'maxon', did you mean maxon_epos4\? available: "):
            Profile.load(text)
    for text in ("maxon/70-15.toml", "./maxon/70-15", "none.toml/x"):
        with pytest.raises(FileError):
            Profile.load(text)


@pytest.mark.parametrize(
    ("text", "is_one"),
    [
        ("maxon_epos4", True), ("maxon_epos4/70-15", True), ("mine.toml", False), ("mine.toml/large", False),
        ("maxon_epos4/mine.toml", False), ("folder/mine.toml", False), ("../maxon_epos4/70-15", False), ("folder/70-15", False),
    ],
)  # fmt: skip
def test_a_name_is_told_from_a_path(text, is_one):
    assert is_name(text) == is_one


# -- what is other in it -----------------------------------------------------------------------------------------------


def test_what_is_not_said_is_the_first_ones():
    pair = family('quirks = ["It hums."]\n' + parameter("level", maximum=12.0))
    large = pair.product(2)
    level = large.parameter("level")
    assert (level.maximum, level.default, level.index) == (12.0, 4, 0x2000)
    assert (level.source, level.evidence) == ("another manual", "eds")
    assert large.parameter("guess") == pair.parameter("guess")
    assert large.quirks == ("All of them are blue.", "It hums.")
    assert pair.parameter("level").maximum == 9.0
    assert (large.sync, large.store) == (pair.sync, pair.store)


def test_a_limit_from_a_file_makes_no_fact_of_a_guess():
    assert family(parameter("guess", maximum=12.0)).product(2).parameter("guess").evidence == "unverified"
    stated = family(parameter("guess", maximum=12.0, evidence="eds", source="f")).product(2).parameter("guess")
    assert (stated.evidence, stated.source) == ("eds", "f")


def test_keys_are_taken_away_and_parameters_are_absent_or_new():
    more = 'absent = ["guess"]\n[product.parameters]\nlevel = { without = ["maximum", "default"] }\n'
    more += 'extra = { index = 0x2002, subindex = 1, data_type = "REAL32", class = "limits", description = "d" }\n'
    pair = family(more)
    large = pair.product(2)
    assert list(large.parameters) == ["level", "extra"]
    assert (large.parameter("level").maximum, large.parameter("level").default) == (None, None)
    assert large.parameter("extra").address == (0x2002, 1)
    assert list(pair.product(1).parameters) == ["level", "guess"]


def test_a_table_of_facts_replaces_the_first_ones():
    more = '[product.store]\nnote = "None."\nsource = "s"\nevidence = "eds"\n'
    pair = family(more)
    assert (pair.product(2).store.object, pair.product(1).store.object) == (None, "1010:1")


def test_an_answer_replaces_that_answer_alone():
    trinamic = PROFILES["trinamic_tmcm16xx"]
    first, other = trinamic.product(0x651).capabilities, trinamic.product(0x686).capabilities
    assert (first.host_closed.answer, other.host_closed.answer) == ("unknown", "no")
    assert first.notch_inside == other.notch_inside


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ('absent = ["levle"]\n', "product large: absent names parameters that the family does not have: levle"),
        ('absent = ["level"]\n' + parameter("level", maximum=1.0), "listed as absent, but described: level"),
        (parameter("extra", index=0x2002, subindex=0), "product large: extra: data_type: Field required; class: Field required"),
        (parameter("guess", index=0x2000), "product large: parameters: level and guess are both in object"),
        (parameter("level", default=70000), "product large: level: default 70000"),
        (parameter("level", maximun=1.0), "unknown key 'maximun', did you mean maximum"),
        ("min_revision = 5\nmax_revision = 4\n", "min_revision 0x5 is above max_revision 0x4"),
        ('[[product]]\nname = "large"\ntitle = "t"\nsource = "s"\nevidence = "eds"\n', "product large is given twice"),
        ('[[product]]\nname = "small"\ntitle = "t"\nsource = "s"\nevidence = "eds"\n', "product small is given twice"),
        (
            '[[product]]\nname = "huge"\ntitle = "t"\nproduct_code = 2\nsource = "s"\nevidence = "eds"\n',
            "large and huge have the same product code and firmware",
        ),
    ],
)
def test_a_product_that_does_not_come_out_whole_is_refused_when_the_file_is_read(more, words):
    with pytest.raises(FileError, match=words):
        family(more)


def test_a_family_of_several_products_names_the_first_one():
    with pytest.raises(FileError, match=r"identity\.product is missing"):
        files.loads(FAMILY.replace('product = "small"\n', ""), Profile)


def test_a_loop_may_not_name_what_the_product_does_not_have():
    text = (VENDORS / "trinamic_tmcm16xx.toml").read_text(encoding="utf-8")
    broken = text + '[[product]]\nname = "x"\ntitle = "X"\nsource = "s"\nevidence = "eds"\nabsent = ["position_gain"]\n'
    with pytest.raises(FileError, match="product x: loop or notch name parameters that are not there: position_gain"):
        files.loads(broken, Profile)


def test_a_change_states_whatever_a_parameter_states():
    """A key that a parameter has and a change has not could not be other in any product."""
    assert set(ParameterChange.model_fields) == set(Parameter.model_fields) | {"without"}
    tables = {name for name, field in Profile.model_fields.items() if field.default is None or name in {"sync", "store"}}
    assert tables - {"capabilities"} <= set(Product.model_fields)
