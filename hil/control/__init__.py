"""The servo law: trajectories, P-PI cascade and variable notch. Pure and compiled."""
