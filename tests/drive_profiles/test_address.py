"""Bus addresses: what is read, what is refused, and in which words."""

import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles.address import BIT_RATES, Address, AddressError, BusChoice, choose_bus, parse_address, parse_bit_rate


@pytest.mark.parametrize(
    ("text", "interface", "channel", "bitrate"),
    [
        ("local:/tmp/robot.sock", "local", "/tmp/robot.sock", None),  # noqa: S108
        ("local:robot.sock", "local", "robot.sock", None),
        ("socketcan:can0", "socketcan", "can0", None),
        ("socketcan:can0@500k", "socketcan", "can0", 500_000),
        ("slcan:/dev/ttyACM0@1M", "slcan", "/dev/ttyACM0", 1_000_000),
        ("pcan:PCAN_USBBUS1@83.333k", "pcan", "PCAN_USBBUS1", 83_333),
        ("kvaser:0@125000", "kvaser", "0", 125_000),
        ("udp_multicast:ff15:7079:7468:6f6e::1", "udp_multicast", "ff15:7079:7468:6f6e::1", None),
        ("  virtual:test\n", "virtual", "test", None),
        ("local:/a folder/bus 1.sock", "local", "/a folder/bus 1.sock", None),
    ],
)
def test_an_address_is_interface_channel_and_bit_rate(text, interface, channel, bitrate):
    assert parse_address(text) == Address(interface, channel, bitrate)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "can0",
        "socketcan",
        "socketcan:",
        ":can0",
        "SocketCAN:can0",
        "0can:x",
        "socketcan:can0@",
        "socketcan:can0@fast",
        "socketcan:can0@500K",
        "socketcan:can0@500kbit",
        "socketcan:can0@-500k",
        "socketcan:can0@1e6",
        "slcan:x@1M@1M",
        "local:/tmp/a@b.sock",
    ],
)
def test_what_is_no_address_is_refused_with_the_text_and_an_example(text):
    with pytest.raises(AddressError) as refused:
        parse_address(text)
    assert refused.value.text == text
    assert repr(text) in str(refused.value)
    assert "socketcan:can0" in str(refused.value)
    assert "@BITRATE" in str(refused.value)


@given(
    st.from_regex(r"[a-z][a-z0-9_]*", fullmatch=True),
    st.text(st.characters(codec="utf-8", exclude_characters="@", exclude_categories=["Cc", "Cs", "Z"]), min_size=1),
    st.none() | st.integers(10_000, 1_000_000),
)
def test_what_an_address_shows_is_read_as_the_same_address(interface, channel, bitrate):
    address = Address(interface, channel, bitrate)
    assert parse_address(str(address)) == address


@pytest.mark.parametrize("rate", ["0", "0.0001k", "7k", "9999", "1000001", "5M"])
def test_a_bit_rate_that_can_cannot_have_is_refused_with_those_that_it_can(rate):
    allowed = "expected 10k, 20k, 50k, 100k, 125k, 250k, 500k, 800k, 1M, or another from 10k to 1M"
    with pytest.raises(AddressError, match=f"^'{rate}' is not a bit rate of classic CAN; {allowed}$"):
        parse_bit_rate(rate)
    with pytest.raises(AddressError, match=f"^HIL_BUS: 'local:/a.sock@{rate}': '{rate}' is not a bit rate .*; {allowed}$"):
        choose_bus(None, None, {"HIL_BUS": f"local:/a.sock@{rate}"})


def test_every_bit_rate_of_the_standard_is_read():
    assert tuple(map(parse_bit_rate, ["10k", "20k", "50k", "100k", "125k", "250k", "500k", "800k", "1M"])) == BIT_RATES


# -- which of several is taken -----------------------------------------------------------------------------------------

OPTION, VARIABLE, FILE = "local:/a.sock", "local:/b.sock", "socketcan:can0"


@pytest.mark.parametrize(
    ("option", "variable", "file", "taken", "words"),
    [
        (OPTION, None, None, OPTION, "bus local:/a.sock, from --bus"),
        (OPTION, VARIABLE, None, OPTION, "bus local:/a.sock, from --bus; not local:/b.sock, as HIL_BUS says"),
        (None, VARIABLE, FILE, VARIABLE, "bus local:/b.sock, from HIL_BUS; not socketcan:can0, as b.toml says"),
        (None, FILE, VARIABLE, FILE, "bus socketcan:can0, from HIL_BUS; not local:/b.sock, as b.toml says"),
        (None, None, FILE, FILE, "bus socketcan:can0, from b.toml"),
        (None, "", FILE, FILE, "bus socketcan:can0, from b.toml"),
        (None, FILE, FILE, FILE, "bus socketcan:can0, from HIL_BUS"),
        (
            OPTION, VARIABLE, FILE, OPTION,
            "bus local:/a.sock, from --bus; not local:/b.sock, as HIL_BUS says; not socketcan:can0, as b.toml says",
        ),
    ],
)  # fmt: skip
def test_the_option_comes_before_the_environment_and_that_before_the_file(option, variable, file, taken, words):
    environment = {} if variable is None else {"HIL_BUS": variable}
    choice = choose_bus(option, None if file is None else ("b.toml", file), environment)
    assert choice is not None
    assert choice.address == taken
    assert str(choice) == words


@pytest.mark.parametrize(
    ("one", "other", "is_same"),
    [
        ("local:/a.sock@1M", "local:/a.sock@1000000", True),
        ("socketcan:can0@500k", "socketcan:can0@0.5M", True),
        ("local:b.sock", f"local:{os.getcwd()}/b.sock", True),
        ("local:/a.sock", "local:/a.sock@1M", False),
        ("socketcan:can0", "socketcan:can1", False),
    ],
)
def test_two_spellings_of_one_bus_are_not_said_to_differ(one, other, is_same):
    choice = choose_bus(None, ("b.toml", other), {"HIL_BUS": one})
    assert (str(choice) == f"bus {one}, from HIL_BUS") is is_same


@pytest.mark.parametrize(("bitrate", "shown"), [(1_000_000, "1M"), (500_000, "500k"), (83_333, "83333"), (125_000, "125k")])
def test_a_bit_rate_is_shown_as_one_types_it(bitrate, shown):
    assert str(Address("local", "/a.sock", bitrate)) == f"local:/a.sock@{shown}"


def test_no_bus_at_all_is_none():
    assert choose_bus(None, None, {}) is None
    assert choose_bus(None, None, {"HIL_BUS": ""}) is None


def test_an_address_that_cannot_be_read_is_refused_by_where_it_stands():
    with pytest.raises(AddressError, match=r"^HIL_BUS: 'can0' is not a bus address"):
        choose_bus(None, ("b.toml", FILE), {"HIL_BUS": "can0"})
    assert choose_bus(OPTION, None, {"HIL_BUS": "can0"}) == BusChoice(OPTION, "--bus", (("HIL_BUS", "can0"),))
