"""CAN frames and the buses that carry them.

`frame` holds the frame and its 16-byte record, `channel` the interface that every bus offers, and `opening` opens the bus at an
address: the local bus, SocketCAN, or any bus of python-can. `bits` counts the bits of a frame on the wire, and `errors_frame`
reads error frames.

>>> from hil.can.bits import duration_ns, frame_bits
>>> from hil.can.frame import Frame, pack
>>> sync = Frame(0x80, b"")
>>> len(pack(sync)), frame_bits(sync), duration_ns(sync, 1_000_000)
(16, 51, 51000)
"""
