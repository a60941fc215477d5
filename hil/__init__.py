"""The bench: servo law, CANopen master, experiments, analysis and report."""
