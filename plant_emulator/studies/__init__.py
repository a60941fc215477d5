"""Studies without a bus.

They are simulated runs, Monte Carlo over plants, and the linearised closed loop.

`studies.simulate` runs an experiment of the bench in one process, `studies.robustness` runs many plants that differ from the
robot file, and `studies.closed_loop` computes poles and resonances:

    >>> from hil.control.cascade import Cascade
    >>> from plant_emulator.robots.robot import load_robot
    >>> from plant_emulator.studies.closed_loop import arm_peak_hz
    >>> robot = load_robot("reference")
    >>> peak_hz = arm_peak_hz(robot.axis[2], Cascade(25.0, 0.2, 4.0), robot.control_period_s)
    >>> 4.0 < peak_hz < 30.0
    True
"""
