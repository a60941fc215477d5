"""The emulated robot: harmonic-drive axes, CANopen drives and an accelerometer on a local bus."""
