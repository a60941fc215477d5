"""The CANopen master: bench file, network, axes, cyclic plan, guard and session."""
