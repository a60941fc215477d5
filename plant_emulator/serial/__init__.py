r"""Serial devices on pseudo-terminals.

They are a LAWICEL CAN adapter (`serial.slcan`) and a serial accelerometer; see docs/serial.md.

>>> from plant_emulator.serial.accelerometer import line_frame
>>> line_frame(7, (1.5, -0.25, 9.80665))
b'$ACC,7,1.50000,-0.25000,9.80665*72\r\n'
"""
