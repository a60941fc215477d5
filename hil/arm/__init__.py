"""Arm of rigid links on revolute joints, from tables or URDF.

`tables` has the links and their masses; `urdf` reads them from a URDF file. `rotation` and `bodies` have the algebra for both.
`kinematics` computes poses and motions, `straight_line` and `line` a straight line of the tip; `mounting` evaluates an
accelerometer on the arm. Pure: no bus, no clock, no drive.

>>> from drive_profiles.files.toml import loads
>>> from hil.arm.tables import ArmTable
>>> arm = loads('''
... tip_m = [0.3, 0.0, 0.0]
... [[link]]
... axis = 1
... origin_m = [0.0, 0.0, 0.4]
... direction = [0.0, -1.0, 0.0]
... body = { mass_kg = 2.0, centre_m = [0.1, 0.0, 0.0], inertia_kg_m2 = { xx = 0.001, yy = 0.02, zz = 0.02 } }
... ''', ArmTable)
>>> arm.axes, arm.bodies()[0].mass_kg
((1,), 2.0)
"""
