"""The process image: a SYNC of drives that only follow, in one call.

`ProcessImage` lays it out, `image.h` says what it does, and `World.exchange` uses it. Here no drive is operational, so SYNC means
nothing to them, and the accelerometer sends nothing yet:

    >>> from hil.can.frame import Frame, pack
    >>> from plant_emulator.robots.robot import load_robot
    >>> from plant_emulator.world import World
    >>> world = World(load_robot("reference"))
    >>> boot_up = world.power_on()
    >>> world.exchange(pack(Frame(0x80, b"")))  # the records of the TPDOs
    b''
    >>> world.exchange(pack(Frame(0x701, b"")))  # no SYNC at its end: for the slaves
"""
