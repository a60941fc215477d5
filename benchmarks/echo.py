"""`python -m benchmarks.echo ADDRESS AXES`: nodes that only echo, as a process: what an RPDO brings goes back with SYNC."""

import contextlib
import os
import socket
import sys

from drive_profiles.address import LOCAL, parse_address
from hil.can import clock
from hil.can.frame import RECORD, Frame, pack, unpack
from hil.can.socketcan import bind_can

SYNC_HEAD = RECORD.pack(0x80, 0, b"")[:4]
PATTERN = b"\x37\x06\x00\x00\x01\x00\x05\x00"
"""A status word, a position and a torque."""


def feedback_ids(count: int) -> list[int]:
    """Identifiers of the TPDOs; those of the RPDOs are 80h above."""
    return [0x181 + n for n in range(count)]


def serve(sock: socket.socket, count: int, *, until_peer_leaves: bool) -> None:
    """Answer each SYNC with a TPDO per node, whose position is what its RPDO has brought last."""
    answers = {can_id + 0x80: pack(Frame(can_id, PATTERN)) for can_id in feedback_ids(count)}
    together = False
    while True:
        message = sock.recv(clock.MAX_RECORDS * RECORD.size)
        if not message:
            if until_peer_leaves:
                return
            continue
        for begin in range(0, len(message), RECORD.size):
            record = message[begin : begin + RECORD.size]
            if record[:4] == SYNC_HEAD:
                for answer in (b"".join(answers.values()),) if together else answers.values():
                    sock.send(answer)
                continue
            can_id = int.from_bytes(record[:4], sys.byteorder)
            old = answers.get(can_id)
            if old is not None:
                answers[can_id] = old[:10] + record[10:14] + old[14:]
            elif can_id == clock.CLOCK_ID and (frame := unpack(record)) is not None:
                asked = clock.read_question(frame.data)
                together = asked is not None and asked.several
                sock.send(pack(clock.answer(clock.LOCK_STEP, None, several=together)))


def main() -> None:
    """Serve one client at a time on the local bus, or all on a CAN interface, until ended by a signal."""
    address, count = parse_address(sys.argv[1]), int(sys.argv[2])
    if address.interface != LOCAL:
        serve(bind_can(address), count, until_peer_leaves=False)
    with contextlib.suppress(FileNotFoundError):
        os.unlink(address.channel)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(address.channel)
        listener.listen(4)
        while True:
            peer, _ = listener.accept()
            with peer, contextlib.suppress(ConnectionError):
                serve(peer, count, until_peer_leaves=True)


if __name__ == "__main__":
    main()
