"""An arm behind several motors, frozen in a posture: `structure` is its dynamics, `loops` the margins of one axis' loop on it."""
