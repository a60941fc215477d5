"""Studies without a bus.

They are simulated runs, Monte Carlo over plants, and the linearised closed loop.

`studies.simulate` runs an experiment of the bench in one process, `studies.robustness` runs many plants that differ from the
robot file, and `studies.closed_loop` computes poles:

    >>> from hil.control.cascade import Cascade
    >>> from plant_emulator.robots.robot import load_robot
    >>> from plant_emulator.studies.closed_loop import frozen_law, growth_per_s
    >>> robot = load_robot("reference")
    >>> growth_per_s(robot.axis[2], frozen_law(Cascade(25.0, 0.2, 4.0), (), [0.0], robot.control_period_s)) < 0.0  # it decays
    True
"""
