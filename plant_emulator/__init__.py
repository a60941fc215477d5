"""The emulated robot on a bus.

It has harmonic-drive axes, CANopen drives and an accelerometer.

Any CANopen master can move it: `plant-emulator serve` puts the robot on a local bus, on SocketCAN or behind a serial
adapter, and `plant_emulator.pytest_plugin` provides it for tests. In Python it is a `plant_emulator.world.World`, sans IO:
frames and time go in, frames come out. Here a master asks the drive of axis 2 for its device type (1000h):

    >>> from hil.can.frame import Frame
    >>> from plant_emulator.robots.robot import load_robot
    >>> from plant_emulator.world import World
    >>> world = World(load_robot("reference"))
    >>> len(world.power_on())  # boot-up messages of three drives and the accelerometer
    4
    >>> answer, = world.receive(Frame(0x602, bytes.fromhex("4000100000000000")))
    >>> answer.data.hex(" ")
    '43 00 10 00 92 01 02 00'
"""
