"""Whole conversations, frame by frame, each beside the clause of CiA 301 that asks for it.

``>`` is what the master sends and ``<`` what the node answers, as identifier and bytes in hexadecimal (``R`` behind the
identifier: a remote request); ``+`` lets milliseconds pass. What is not written is not sent.
"""

import pytest

from hil.can.frame import CAN_RTR_FLAG

MS = 1_000_000

MAPPING = """
# 7.5.2.38: TPDO 1 is made invalid, its mapping switched off, changed and switched on, and the PDO made valid again
> 605 2F 00 1A 00 00 00 00 00   while it is valid the mapping cannot be changed
< 585 80 00 1A 00 00 00 01 06
> 605 23 00 18 01 85 01 00 80
< 585 60 00 18 01 00 00 00 00
> 605 23 00 1A 01 10 00 77 60   nor its objects while the number is not 0
< 585 80 00 1A 01 00 00 01 06
> 605 2F 00 1A 00 00 00 00 00
< 585 60 00 1A 00 00 00 00 00
> 605 23 00 1A 01 10 00 FF 5F   there is no 5FFFh
< 585 80 00 1A 01 00 00 02 06
> 605 23 00 1A 01 10 00 40 60   the control word is of an RPDO
< 585 80 00 1A 01 41 00 04 06
> 605 23 00 1A 01 08 00 41 60   the status word is mapped whole or not at all
< 585 80 00 1A 01 41 00 04 06
> 605 23 00 1A 01 01 00 06 20
< 585 60 00 1A 01 00 00 00 00
> 605 23 00 1A 02 10 00 41 60
< 585 60 00 1A 02 00 00 00 00
> 605 23 00 1A 03 20 00 64 60
< 585 60 00 1A 03 00 00 00 00
> 605 23 00 1A 04 20 00 64 60
< 585 60 00 1A 04 00 00 00 00
> 605 2F 00 1A 00 04 00 00 00   81 bits
< 585 80 00 1A 00 42 00 04 06
> 605 2F 00 1A 00 09 00 00 00   nine objects
< 585 80 00 1A 00 42 00 04 06
> 605 23 00 1A 09 20 00 64 60   a ninth position
< 585 80 00 1A 09 11 00 09 06
> 605 2F 00 1A 00 02 00 00 00
< 585 60 00 1A 00 00 00 00 00
> 605 23 00 18 01 85 01 00 20   bit 29, a 29-bit identifier
< 585 80 00 18 01 30 00 09 06
> 605 23 00 18 01 85 01 00 00
< 585 60 00 18 01 00 00 00 00
> 605 23 00 18 01 86 01 00 00   the identifier does not change while the PDO exists
< 585 80 00 18 01 30 00 09 06
> 605 2B 00 18 03 0A 00 00 00   nor does the inhibit time
< 585 80 00 18 03 30 00 09 06
> 605 2F 00 18 06 02 00 00 00   nor does the SYNC start value
< 585 80 00 18 06 30 00 09 06
> 605 2F 00 18 04 00 00 00 00   sub-index 4 is reserved
< 585 80 00 18 04 11 00 09 06
> 605 2F 00 18 02 F1 00 00 00   and so is transmission type 241
< 585 80 00 18 02 30 00 09 06
> 605 2F 00 14 02 FD 00 00 00   253 is of a TPDO
< 585 80 00 14 02 30 00 09 06
> 000 01 05
> 080
< 185 00 00 00
"""

COUNTER = """
# 7.5.2.22: 1 and 241 to 255 are reserved
> 605 2F 19 10 00 01 00 00 00
< 585 80 19 10 00 30 00 09 06
> 605 2F 19 10 00 F1 00 00 00
< 585 80 19 10 00 30 00 09 06
> 605 2F 19 10 00 03 00 00 00
< 585 60 19 10 00 00 00 00 00
# 7.5.2.37: TPDO 1 goes every second SYNC, and that with counter 3 is its first
> 605 23 00 18 01 85 01 00 80
< 585 60 00 18 01 00 00 00 00
> 605 2F 00 18 02 02 00 00 00
< 585 60 00 18 02 00 00 00 00
> 605 2F 00 18 06 F1 00 00 00
< 585 80 00 18 06 30 00 09 06
> 605 2F 00 18 06 03 00 00 00
< 585 60 00 18 06 00 00 00 00
> 605 23 00 18 01 85 01 00 00
< 585 60 00 18 01 00 00 00 00
> 000 01 05
> 080 01
> 080 02
> 080 03
> 080 01
< 185 00 00 00 00 00 00 00 00
> 080 02
> 080 03
< 185 00 00 00 00 00 00 00 00
# 7.2.7.1: a SYNC of another length than 1019h announces
> 080
< 085 40 82 11 00 00 00 00 00
> 080 01
< 085 00 00 00 00 00 00 00 00
> 080 02
< 185 00 00 00 00 00 00 00 00
"""

REQUESTS = """
# 7.5.2.37: type 252 is sampled at SYNC and sent on request
> 605 2F 00 18 02 FC 00 00 00
< 585 60 00 18 02 00 00 00 00
> 185R
> 000 01 05
> 185R
> 080
> 185R
< 185 00 00 00 00 00 00 00 00
# type 253 at the request
> 605 2F 00 18 02 FD 00 00 00
< 585 60 00 18 02 00 00 00 00
> 080
> 185R
< 185 00 00 00 00 00 00 00 00
# bit 30: no request is answered
> 605 23 00 18 01 85 01 00 40
< 585 60 00 18 01 00 00 00 00
> 185R
"""

DEADLINE = """
# 7.5.2.35: RPDO 1, of 6 bytes, has a deadline of 10 ms, which begins with the first frame
> 605 2B 00 14 05 0A 00 00 00
< 585 60 00 14 05 00 00 00 00
> 000 01 05
+ 50
> 205 0F 00 00 00 00 00
+ 9
> 205 0F 00 00 00 00 00
+ 9
+ 1
< 085 50 82 11 00 00 00 00 00
+ 50
> 205 0F 00 00 00 00 00
< 085 00 00 00 00 00 00 00 00
# 7.2.7.1: too short, and too long
> 205 0F 00 00 00 00
< 085 10 82 11 00 00 00 00 00
> 205 0F 00 00 00 00 00 00
< 085 20 82 11 00 00 00 00 00
+ 10
< 085 50 82 11 00 00 00 00 00
# one cause is over, the other one is not
> 205 0F 00 00 00 00 00 00
> 205 0F 00 00 00 00 00
< 085 00 00 00 00 00 00 00 00
# pre-operational ends both
+ 10
< 085 50 82 11 00 00 00 00 00
> 000 80 05
< 085 00 00 00 00 00 00 00 00
+ 50
"""


def parsed(transcript):
    """Give the kind of each line with its frame or its milliseconds, remarks left out."""
    for line in transcript.strip().splitlines():
        kind, *words = line.split("   ")[0].split()
        if kind == "+":
            yield kind, int(words[0])
        elif kind in "<>":
            can_id = int(words[0].rstrip("R"), 16) | (CAN_RTR_FLAG if words[0].endswith("R") else 0)
            yield kind, (can_id, bytes.fromhex("".join(words[1:])))


@pytest.mark.parametrize("transcript", [MAPPING, COUNTER, REQUESTS, DEADLINE], ids=["mapping", "counter", "requests", "deadline"])
def test_the_node_speaks_as_the_standard_has_it(bench, transcript):
    waiting = []
    for kind, what in parsed(transcript):
        if kind == "<":
            assert waiting, f"nothing was sent, but {what[0]:03X} {what[1].hex(' ')} is due"
            assert waiting.pop(0) == what
            continue
        assert waiting == []
        waiting = bench.send(*what) if kind == ">" else [frame for _, frame in bench.wait(what)]
    assert waiting == []
