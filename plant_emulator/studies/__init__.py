"""Studies without a bus.

They are simulated runs, Monte Carlo over plants, and the linearised closed loop.

`studies.simulate` runs an experiment of the bench in one process, `studies.robustness` runs many plants that differ from the
robot file, and `studies.closed_loop` computes poles:

    >>> from hil.control.cascade import Cascade
    >>> from hil.design.frequency import Loop
    >>> from plant_emulator.robots.robot import load_robot
    >>> from plant_emulator.studies.closed_loop import frozen_laws, growth_per_s, linear_plant
    >>> axis = load_robot("reference").axis[2]
    >>> laws = frozen_laws(Loop(linear_plant(axis), Cascade(25.0, 0.2, 4.0)), [0.0])
    >>> growth_per_s(axis, laws, 250e-6) < 0.0  # it decays
    True
"""
