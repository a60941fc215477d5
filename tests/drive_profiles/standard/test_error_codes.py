"""Error codes in words: one table for emergencies, 603Fh and 1003h, with the maker's own codes first."""

import pytest

from drive_profiles.errors import FileError
from drive_profiles.family.profile import Profile, available
from drive_profiles.files import toml as files
from drive_profiles.standard.error_codes import code_text, emergency_text, error_text, register_words
from tests.drive_profiles import upload_rig as rig

CODE = '[[fault_codes]]\ncode = 0x8A82\ntext = "{}"\nsource = "test"\nevidence = "definition"\n'


def with_codes(*texts):
    """The rig's profile, with one code of its own for each text."""
    return files.loads(rig.HEAD.partition("[identity]")[0] + "[identity]" + rig.HEAD.partition("[identity]")[2].replace(
        "[parameters]", "".join(map(CODE.format, texts)) + "[parameters]"
    ), Profile)  # fmt: skip


def test_the_maker_s_words_come_before_the_standard_s():
    own = with_codes("software position limit").fault_texts
    assert error_text(0x8A82, own) == "software position limit"
    assert code_text(0x8A82, own) == "8A82h (software position limit)"
    assert emergency_text(0x8A82, 0x81, own) == "emergency 8A82h (software position limit; error register 81h)"
    assert error_text(0x8611, own) == "following error"


def test_a_code_is_stated_once():
    with pytest.raises(FileError, match="8A82h is given twice"):
        with_codes("one", "another")


def test_every_code_of_16_bits_has_words_and_says_where_they_are_those_of_its_group():
    for code in range(0, 0x10000, 7):
        assert error_text(code)
        assert code_text(code).startswith(f"{code:04X}h (")
    assert code_text(0x8613) == "8613h (positioning controller, of the maker's own)"
    assert code_text(0xE123) == "E123h (unknown code)"


def test_the_bits_of_the_error_register_are_those_of_cia_301():
    assert register_words(0) == ["no error"]
    assert register_words(0x15) == ["generic", "voltage", "communication"]
    assert len(register_words(0xFF)) == 8


@pytest.mark.parametrize("name", available())
def test_no_profile_repeats_the_standard_s_words(name):
    for each in Profile.load(name).fault_codes:
        assert error_text(each.code) != each.text
        assert each.source.strip()
