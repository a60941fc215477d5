r"""A CANopen slave engine (CiA 301 and CiA 305).

It uses no sockets, threads or clocks: frames and time go in, frames come out.

`slave.node.Slave` puts the services together over a `slave.dictionary.Dictionary`. Times are ns of the owner's clock.

    >>> from hil.can.frame import Frame
    >>> from plant_emulator.slave.dictionary import Dictionary
    >>> from plant_emulator.slave.node import Slave
    >>> from plant_emulator.slave.objects import communication_entries
    >>> slave = Slave(5, Dictionary(communication_entries(device_type=0, name="Sensor"), node_id=5))
    >>> slave.power_on(0)  # the boot-up message
    [Frame(can_id=1797, data=b'\x00')]
    >>> answer, = slave.receive(Frame(0x605, bytes.fromhex("4008100000000000")), 1_000)  # upload 1008h, the device name
    >>> answer.data.hex(" ")
    '41 08 10 00 06 00 00 00'
"""
