r"""The accelerometer at the tip as a CANopen node (CiA 404).

`plant_emulator.serial` has the one on a serial port.

>>> from hil.can.frame import Frame
>>> from plant_emulator.sensor.accelerometer import AccelerometerNode
>>> node = AccelerometerNode(16, lambda: (0.0, 0.0, 9.80665), range_m_s2=40.0)
>>> node.power_on(0)  # the boot-up message
[Frame(can_id=1808, data=b'\x00')]
"""
