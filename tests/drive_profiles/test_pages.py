"""The pages of docs/drives: what they say, and that they are what the profiles say."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from drive_profiles.cli.main import app
from drive_profiles.family.profile import Profile
from drive_profiles.pages import SIGN, index, page, written
from tests.drive_profiles.profiles import PROFILES as BY_NAME

DOCS = Path(__file__).parents[2] / "docs" / "drives"
PROFILES = list(BY_NAME.values())
EMULATED = BY_NAME["emulated_drive"]


@pytest.mark.parametrize("profile", PROFILES, ids=lambda profile: profile.name)
def test_the_page_is_what_the_profile_says(profile):
    path = DOCS / f"{profile.name}.md"
    assert path.is_file(), "run: drive-profiles pages --out docs/drives"
    assert path.read_text(encoding="utf-8") == page(profile), "run: drive-profiles pages --out docs/drives"


def test_the_index_lists_every_profile_and_no_page_is_left_over():
    assert (DOCS / "README.md").read_text(encoding="utf-8") == index(PROFILES), "run: drive-profiles pages --out docs/drives"
    assert {path.name for path in DOCS.glob("*.md")} == set(written(PROFILES))


def test_answers_with_their_reasons_facts_and_parameters():
    text = page(EMULATED)
    assert text.startswith("# Emulated servo drive with the variable notch inside\n")
    for _, capability in EMULATED.capabilities:
        assert f"| **{capability.answer}** | {capability.reason} |" in text
    assert "| vendor id | 0x48494C01 |" in text
    assert "| period | 250 µs |" in text
    assert "| min frequency | 0.01 Hz |" in text
    assert "| velocity_gain_nm_s_rad | `velocity_gain_nm_s_rad` | 1 |" in text
    assert "| `torque_limit_nm` | 6072:0 | UNSIGNED16 | N·m | 1 ‰ of 6076h | 0 … | now |" in text
    assert "| 2 | 11.84 Hz | 12.34 Hz | 11.84 Hz, ζ 0.028 | 12.34 Hz, ζ 0.100 | 0.0 dB | exact |" in text
    assert "| object | 1010:1 |" in text


@pytest.mark.parametrize("profile", PROFILES, ids=lambda profile: profile.name)
def test_every_parameter_and_source_is_there_once(profile):
    text = page(profile)
    for name, entry in profile.parameters.items():
        assert text.rpartition("## Parameters")[2].count(f"| `{name}` | {entry.written_address} |") == 1
    for fact in (profile.identity, profile.store, *profile.parameters.values()):
        assert fact.source in text.rpartition("## Sources")[2]


def test_what_is_unverified_carries_the_sign():
    facts = EMULATED.model_dump(by_alias=True)
    facts["parameters"]["lowpass_hz"]["evidence"] = "unverified"
    facts["store"]["evidence"] = "unverified"
    profile = Profile.model_validate(facts)
    lines = page(profile).splitlines()
    assert next(line for line in lines if line.startswith("| `lowpass_hz` | 2101")).count(f"{SIGN} unverified") == 1
    assert sum(SIGN in line for line in lines) == 3  # the explanation, the parameter, the store command
    assert page(EMULATED).count(SIGN) == 1
    assert index([profile]).splitlines()[-1].endswith("| 2 |")


def test_a_default_that_states_nothing_of_a_drive_is_not_on_its_page():
    """The module has no 6076h, and no source has the signs and the scale of its coefficients."""
    unknown = page(BY_NAME["kollmorgen_rgm"])
    assert [words for words in ("rated torque step", "sign of a·y", "frequency step", "damping | 0 |") if words in unknown] == []
    assert "| sign of a·y | 1 |" in page(BY_NAME["copley_plus"])
    assert "| rated torque step | 1e-06 N·m |" in page(BY_NAME["maxon_epos4"])
    assert "| frequency step | 0.001 Hz |" in page(BY_NAME["kollmorgen_akd"])
    assert "signature" not in page(BY_NAME["schunk_pilz_prbt"])


def test_a_bar_does_not_break_a_table():
    facts = EMULATED.model_dump(by_alias=True)
    facts["parameters"]["lowpass_hz"]["description"] = "either | or"
    facts["quirks"] = ("It is odd.",)
    facts["aborts"] = ({"code": 0x0F00FFC0, "text": "wrong state", "source": "test", "evidence": "eds"},)
    text = page(Profile.model_validate(facts))
    assert "either \\| or" in text
    assert "- It is odd." in text
    assert "| 0x0F00FFC0 | wrong state | eds [" in text


def test_the_command_writes_them(tmp_path):
    result = CliRunner().invoke(app, ["pages", "--out", str(tmp_path / "drives")])
    assert result.exit_code == 0
    assert {path.name for path in (tmp_path / "drives").iterdir()} == set(written(PROFILES))


@pytest.mark.parametrize("profile", [p for p in PROFILES if p.products], ids=lambda profile: profile.name)
def test_a_page_says_how_products_are_told_apart_and_what_is_other_in_each(profile):
    text = page(profile).partition("\n## Products\n")[2].partition("\n## Parameters\n")[0]
    for product, member in zip(profile.products, profile.members[1:], strict=True):
        part = text.partition(f"\n### {member.title}\n")[2].partition("\n### ")[0]
        assert text.count(f"| `{product.name}` | {member.title} |") == 1
        assert all(f"`{name}`" in part for name in product.absent)
        assert all(f"| `{name}` | {member.parameters[name].written_address} |" in part for name in product.parameters)
        assert all(answer.reason in part for answer in product.capabilities.values())
        assert all(fact.note in part for fact in product.facts.values())
        assert f"`{member.label}`" in index(PROFILES)


def test_a_family_of_one_product_has_no_such_section():
    assert "## Products" not in page(EMULATED)
    assert "Further products" not in index([EMULATED])
