"""The servo law: trajectories, P-PI cascade, variable notch and cancellation.

Host and emulated drive run the same law. `servo` has it whole for one axis, `servo_bank` for several; `cascade`, `notch` and
`cancellation` are its parts. `trajectory` and `excitation` make references, `treatments` names what acts against the vibration.
The law is C: each header beside these modules has the equations of one part and the records that it works on.

>>> from hil.control.cascade import Cascade
>>> from hil.control.servo import Servo, ServoConfig
>>> gains = Cascade(position_gain_per_s=25.0, velocity_gain_nm_s_rad=0.03, velocity_integral_gain_nm_rad=0.5, lowpass_hz=300.0)
>>> law = Servo(ServoConfig(gains, torque_limit_nm=1.5), period_s=250e-6)
>>> law.start(motor_angle=0.0)
>>> round(law.step(position=0.1, motor_angle=0.0), 4)
0.0752
"""
