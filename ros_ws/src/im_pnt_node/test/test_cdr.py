"""Packets as bytes: they come back as they were, and no bytes do harm."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_pnt.errors import NetError
from im_pnt_node.ros.cdr import decode_packet, encode_packet


@given(st.text())
def test_a_packet_comes_back(text):
    assert decode_packet(encode_packet(text)) == text


def test_it_is_the_cdr_of_a_string():
    assert encode_packet("ab") == bytes.fromhex("00010000 03000000 616200")
    assert decode_packet(bytes.fromhex("00000000 00000003 616200")) == "ab"


@given(st.binary(max_size=40) | st.binary(max_size=20).map(lambda rest: b"\0\1\0\0" + rest))
def test_foreign_bytes_are_a_packet_or_refused(data):
    try:
        text = decode_packet(data)
    except NetError:
        return
    assert text.encode() in data


@pytest.mark.parametrize("length", [0, 1 << 31, 0xFFFFFFFF, 5])
def test_a_length_that_does_not_fit_is_refused(length):
    with pytest.raises(NetError, match="says that its text ends"):
        decode_packet(b"\0\1\0\0" + length.to_bytes(4, "little") + b"ab\0")
