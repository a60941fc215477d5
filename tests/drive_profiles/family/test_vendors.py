"""What every profile of the package promises, whoever's drive it is."""

import math
import re
import tomllib
from collections import Counter

import pytest

from drive_profiles import pages
from drive_profiles.family.profile import VENDORS
from drive_profiles.files.toml import split_unit
from drive_profiles.standard.cia402 import Mode
from drive_profiles.standard.object_address import object_address
from tests.drive_profiles.profiles import ALL_DRIVES, DRIVES, PRODUCTS, PROFILES

NEEDED_START_HZ = 8.0
"""Frequency at which the paper's notch begins, k f_s = 2 · 4 rps."""
NEEDED_ZETA_RN = 0.028
"""Damping of the zeros of the paper's notch, Table 3."""

FAMILIES = {
    "copley_plus",
    "elmo_gold",
    "emulated_drive",
    "harmonic_drive_yukondrive",
    "kollmorgen_akd",
    "kollmorgen_rgm",
    "maxon_epos2",
    "maxon_epos4",
    "nanotec_cl4e",
    "novanta_eve",
    "schunk_pilz_prbt",
    "technosoft_ipos",
    "trinamic_tmcm16xx",
    "yiyou_euservo",
    "zeroerr_erob",
}
EVERY = {**PROFILES, **PRODUCTS}
STANDARD = {
    parameter.address: name for name, parameter in DRIVES["emulated_drive"].parameters.items() if parameter.index >= 0x6000
}
STEMS = {place: split_unit(name)[0] for place, name in STANDARD.items()}
OTHER_MEANING = {("copley_plus", (0x6065, 0)): "following_error_warning_rad"}  # there 6065h only warns, and 2120h trips
COUNTS_NOT_STATED = {
    "elmo_gold",
    "maxon_epos2",
    "technosoft_ipos/isd860",
}  # no object of theirs does: their positions are not converted yet
MACHINE_PATH = re.compile(r"(?:^|[\s;,(])(?:/|~/|\./|\.\./|[A-Za-z]:\\)\w|file://", re.IGNORECASE)

each_profile = pytest.mark.parametrize("profile", EVERY.values(), ids=EVERY)
each_drive = pytest.mark.parametrize("profile", ALL_DRIVES.values(), ids=ALL_DRIVES)


def document(profile):
    return tomllib.loads((VENDORS / f"{profile.name}.toml").read_text(encoding="utf-8"))


def facts(table, path=()):
    """Every table of a file that says how it is known, by its path."""
    if isinstance(table, dict):
        if "source" in table or "evidence" in table:
            yield path, table
        for key, value in table.items():
            yield from facts(value, (*path, key))
    elif isinstance(table, list):
        for number, value in enumerate(table):
            yield from facts(value, (*path, number))


def strings(value):
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for entry in value.values() if isinstance(value, dict) else value:
            yield from strings(entry)


def addresses(profile):
    """The objects that the tables beside ``parameters`` name."""
    for table in (profile.torque, profile.encoder, profile.load_encoder, profile.store):
        for name, value in {} if table is None else table.model_dump().items():
            if isinstance(value, str) and name not in {"source", "evidence", "note"}:
                yield f"{type(table).__name__}.{name}", value


def named_parameters(profile):
    """The parameters that loop and notch name."""
    named = [gain.parameter for gain in profile.loop.gains.values()] if profile.loop else []
    for section in profile.notch.sections if profile.notch else ():
        named += [*section.parts.values(), *section.settings]
    return named


def test_the_families_are_there():
    assert set(DRIVES) >= FAMILIES


def test_no_two_families_claim_the_same_device():
    claimed = Counter(
        (profile.identity.vendor_id, code)
        for profile in PROFILES.values()
        for code in {member.identity.product_code for member in profile.members} - {None}
    )
    assert [device for device, count in claimed.items() if count > 1] == []


# --- sources ----------------------------------------------------------------------------------------------------------


@each_profile
def test_every_fact_says_where_it_is_from_and_how_it_is_known(profile):
    found = dict(facts(document(profile)))
    assert len(found) >= len(profile.parameters) + 2  # beside them identity and store at the least
    for path, fact in found.items():
        assert fact.get("source", "").strip(), path
        assert fact.get("evidence"), path


@each_profile
def test_no_text_names_a_place_on_somebodys_machine(profile):
    assert [text for text in strings(document(profile)) if MACHINE_PATH.search(text)] == []


@pytest.mark.parametrize(
    ("text", "is_one"),
    [
        ("EDS in /home/me/eds/Drive.eds, [2168]", True),
        ("~/Downloads/manual.pdf", True),
        ("../eds/Drive.eds", True),
        (r"C:\eds\Drive.eds", True),
        ("file:///tmp/drive.eds", True),
        ("https://example.com/manual?p=4", False),
        ("owner/name, src/bus.yml; 607Ah and/or 60FFh", False),
        ("1/s, N·m/rad", False),
    ],
)
def test_what_counts_as_such_a_place(text, is_one):
    assert bool(MACHINE_PATH.search(text)) == is_one


@each_profile
def test_descriptions_and_reasons_are_sentences(profile):
    texts = [parameter.description for parameter in profile.parameters.values()]
    if profile.capabilities is not None:
        texts += [entry["reason"] for entry in profile.capabilities.model_dump().values()]
    assert [text for text in (*texts, *profile.quirks) if not text.endswith((".", "!"))] == []


# --- objects ----------------------------------------------------------------------------------------------------------


@each_drive
def test_loop_and_notch_name_parameters_that_can_be_used(profile):
    named = named_parameters(profile)
    assert set(named) <= set(profile.parameters)
    if profile.loop.structure != "not accessible":
        held = [profile.parameter(gain.parameter) for gain in profile.loop.gains.values()]
        assert [parameter.written_address for parameter in held if parameter.access != "rw"] == []
    for section in profile.notch.sections if profile.notch else ():
        assert [name for name in section.settings if profile.parameter(name).access != "rw"] == []


@each_profile
def test_every_object_of_the_vendor_is_a_parameter(profile):
    """The vendor area has no standard to look a type up in, so what is named there must be described."""
    known = {parameter.address for parameter in profile.parameters.values()}
    vendors = {what: address for what, address in addresses(profile) if 0x2000 <= object_address(address)[0] < 0x6000}
    commands = {"Store.object", "Store.restore"}  # their type is the signature's, UNSIGNED32
    assert {
        what: address for what, address in vendors.items() if what not in commands and object_address(address) not in known
    } == {}


@each_profile
def test_what_counts_in_the_drives_units_can_be_converted(profile):
    """Else a pull can only list it as not read, and a tuned drive is not carried over whole."""
    scales = {parameter.scale for parameter in profile.parameters.values() if isinstance(parameter.scale, str)}
    if "per mille" in scales:
        assert profile.torque.rated_torque
    if "counts" in scales:
        tells = profile.encoder.increments is not None or profile.encoder.counts_per_rev is not None
        assert tells != (profile.label in COUNTS_NOT_STATED)


@each_profile
def test_defaults_lie_inside_their_own_limits(profile):
    for name, parameter in profile.parameters.items():
        default = parameter.default
        if isinstance(default, str) or default is None or isinstance(parameter.scale, str):
            continue
        value = parameter.value(default)
        low = -math.inf if parameter.minimum is None else parameter.minimum
        high = math.inf if parameter.maximum is None else parameter.maximum
        assert low <= value <= high or math.isclose(value, low) or math.isclose(value, high), name


@each_profile
def test_a_default_can_be_written_back(profile):
    for name, parameter in profile.parameters.items():
        if parameter.default is None or isinstance(parameter.scale, str) or isinstance(parameter.default, str):
            continue
        if parameter.access == "rw":
            assert parameter.encoded(parameter.value(parameter.default)) == parameter.default_bytes(), name


# --- names ------------------------------------------------------------------------------------------------------------


def test_the_table_of_names_is_the_emulated_drives():
    assert STANDARD[0x6072, 0] == "torque_limit_nm"
    assert STANDARD[0x607D, 1] == "position_limit_min_rad"
    assert STANDARD[0x607D, 2] == "position_limit_max_rad"
    assert STEMS[0x6065, 0] == "following_error_window"


@each_drive
def test_the_standards_objects_have_one_name_each(profile):
    """In the unit of the emulated drive the very name, in another unit that name with the other unit, or with none.

    A vendor's object may bear the name where the drive lacks the standard's.
    """
    pattern = DRIVES["emulated_drive"]
    places = {parameter.address for parameter in profile.parameters.values()}
    for name, parameter in profile.parameters.items():
        place = parameter.address
        if name == OTHER_MEANING.get((profile.name, place)):
            continue
        if place not in STANDARD:
            assert not [other for other, stem in STEMS.items() if split_unit(name)[0] == stem and other in places], name
        elif parameter.unit == pattern.parameter(STANDARD[place]).unit:
            assert name == STANDARD[place]
        else:
            assert split_unit(name)[0] == STEMS[place]


# --- capabilities -----------------------------------------------------------------------------------------------------


@each_drive
def test_a_notch_that_falls_short_says_by_which_number(profile):
    for answer in (profile.capabilities.notch_inside, profile.capabilities.notch_variable_while_moving):
        if answer.answer == "approximate":
            assert re.search(r"\d", answer.reason), answer
    inside = profile.capabilities.notch_inside
    if inside.answer in {"approximate", "lost", "no"}:
        assert re.search(r"\d", inside.reason), inside


@each_drive
def test_the_notch_that_is_promised_is_the_notch_that_is_described(profile):
    answer, notch = profile.capabilities.notch_inside.answer, profile.notch
    if notch is None:
        assert answer in {"no", "unknown"}
        return
    if notch.min_frequency_hz is not None and notch.min_frequency_hz > NEEDED_START_HZ:
        assert answer == "no"
    if notch.min_zero_damping > NEEDED_ZETA_RN or notch.form == "symmetric" or notch.word == "fixed point":
        assert answer != "exact"
    if notch.word == "integer, scaling not known":
        assert answer in {"no", "unknown"}


@each_drive
def test_a_profile_says_of_its_notch_what_the_table_of_its_page_says(profile):
    """The worst verdict of `realise` on Table 3 of the paper is the profile's answer, in the same word."""
    page = pages.page(profile)
    verdicts = [word for word in ("exact", "approximate", "lost") if re.search(rf"dB \| {word}\b", page)]
    if verdicts:
        assert profile.capabilities.notch_inside.answer == verdicts[-1]


@each_drive
def test_a_notch_that_is_not_there_does_not_move(profile):
    capabilities = profile.capabilities
    if capabilities.notch_inside.answer == "no":
        assert capabilities.notch_variable_while_moving.answer == "no"
    if capabilities.notch_variable_while_moving.answer in {"exact", "yes"}:
        assert profile.notch is not None
        assert profile.notch.changed_by in {"drive", "PDO"}


@each_drive
def test_p_pi_is_promised_only_of_a_p_pi(profile):
    if profile.capabilities.p_pi_inside.answer in {"exact", "yes"}:
        assert profile.loop.structure == "P-PI"
        assert profile.loop.is_verified
    if profile.loop.structure == "not accessible":
        assert profile.loop.gains == {}


@each_drive
def test_what_is_promised_over_the_bus_has_its_mode_and_its_object(profile):
    capabilities, modes = profile.capabilities, profile.supported_modes
    if capabilities.host_closed.answer in {"exact", "yes"}:
        assert Mode.CST in modes
        assert profile.torque.target
    if capabilities.reference_correction.answer in {"exact", "yes"}:
        assert Mode.CSP in modes
    if capabilities.torque_offset.answer in {"exact", "yes"}:
        assert profile.torque.offset
