"""Studies without a bus.

>>> from hil.control.cascade import Cascade
>>> from hil.design.frequency import Loop
>>> from plant_emulator.robots.robot import load_robot
>>> from plant_emulator.studies.closed_loop import frozen_laws, growth_per_s, linear_plant
>>> axis = load_robot("reference").axis[2]
>>> laws = frozen_laws(Loop(linear_plant(axis), Cascade(25.0, 0.2, 4.0)), [0.0])
>>> growth_per_s(axis, laws, 250e-6) < 0.0  # it decays
True
"""
