"""`python -m benchmarks.emulator PATH AXES PERIOD_S BITRATE`: the emulated robot of any number of axes, until stdin closes."""

import sys

from benchmarks.robots import robot_of
from plant_emulator.bus.medium import medium_for
from plant_emulator.bus.server import Server
from plant_emulator.world import World


def main() -> None:
    """Serve it, 0 bit/s meaning no bit times."""
    path, count, period_s, bitrate = sys.argv[1:]
    world = World(robot_of(int(count), float(period_s)))
    server = Server(world, path, medium=medium_for(world, int(bitrate) or None))
    server.watch(sys.stdin.fileno())
    server.run()


if __name__ == "__main__":
    main()
