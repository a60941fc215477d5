"""The emulated bus between a world and its clients.

It keeps frames in order, either without bit times or with bit times, arbitration and errors.

    >>> from hil.can.frame import Frame
    >>> from plant_emulator.bus.in_process import InProcessChannel
    >>> from plant_emulator.robots.robot import load_robot
    >>> from plant_emulator.world import World
    >>> channel = InProcessChannel(World(load_robot("reference")))
    >>> len(channel.receive_all(0.0))  # boot-up messages
    4
    >>> channel.send(Frame(0x602, bytes.fromhex("4000100000000000")))
    >>> channel.receive(0.0).data.hex(" ")
    '43 00 10 00 92 01 02 00'
"""
