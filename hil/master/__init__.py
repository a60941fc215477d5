"""CANopen master: a session that checks drives and runs motions.

`session` is the entry point. `network` has SDO, NMT and heartbeats, `drive/` a CiA 402 drive, `cyclic` the exchange of each
cycle, `run` the steps of a run; `guard` and `supervision` give reasons to stop it. `realtime` and `lateness` serve runs in
wall-clock time.

>>> import numpy as np
>>> from hil.bench.bench import load_bench
>>> from hil.can.opening import open_channel
>>> from hil.emulator import EmulatorProcess
>>> from hil.master.motion import Motion
>>> from hil.master.session import Session
>>> from hil.recording import BusLog
>>> time_s = 0.002 * np.arange(201)
>>> there_and_back = 0.5 - 0.5 * np.cos(5.0 * np.pi * time_s)
>>> turn = Motion(axes=(2,), time_s=time_s, motor_angle_rad=there_and_back[:, np.newaxis], starts_at_home=False)
>>> with EmulatorProcess("reference") as robot:
...     channel = open_channel(robot.address)
...     with Session(load_bench("reference"), channel, BusLog(None)) as session:
...         session.bring_up()
...         result = session.run(turn, filters="notch", loop="drive")
...     channel.close()
>>> result.stopped, result.missed_cycles, result.recording.axes
(None, 0, (2,))
"""
