"""Bus addresses: what is read, what is refused, and in which words."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles.address import Address, AddressError, parse_address


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
        "socketcan:can0@0",
        "socketcan:can0@0.0001k",
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
    st.none() | st.integers(1, 10**8),
)
def test_what_an_address_shows_is_read_as_the_same_address(interface, channel, bitrate):
    address = Address(interface, channel, bitrate)
    assert parse_address(str(address)) == address
