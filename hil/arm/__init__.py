"""An arm as rigid links on joints that turn: tables of a bench or robot file, or of a URDF file.

`tables` has the links and what they carry, `urdf` reads them from a URDF file, `rotation` and `bodies` are the algebra behind
both. `kinematics` moves it, along a line by `straight_line` and `line`; `mounting` reads a sensor on it. Pure: no bus, no clock,
no drive.

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
