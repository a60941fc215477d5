"""Make the machine code that most tests run, where it does not lie on disk yet: `python -m tests.machine_code`."""

from hil.control.servo_bank import bank_step
from plant_emulator.motion.period import advance
from plant_emulator.motion.transitions import begin_mode, begin_stop


def is_there() -> bool:
    """True where the functions of either end have machine code on disk, which is newer than every source it is made of."""
    doors = (advance, begin_mode, begin_stop, bank_step)
    return all(any(each._folder().glob(f"{each.py_func.__name__}-*.o")) for each in doors)


def make() -> None:
    """Rehearse as a served robot does, and run a short motion with the loop in the drive and one with it in the host."""
    from hil.bench.bench import load_bench  # noqa: PLC0415 - half a second, and mostly all is there
    from hil.experiments.motions import constant_acceleration  # noqa: PLC0415
    from hil.master.session import Session  # noqa: PLC0415
    from hil.recording import BusLog  # noqa: PLC0415
    from plant_emulator.bus.in_process import InProcessChannel  # noqa: PLC0415
    from plant_emulator.bus.medium import medium_for  # noqa: PLC0415
    from plant_emulator.motion.axes import rehearse  # noqa: PLC0415
    from plant_emulator.robots.robot import load_robot  # noqa: PLC0415
    from plant_emulator.world import World  # noqa: PLC0415

    rehearse(load_robot("reference"))
    bench = load_bench("reference")
    motion = bench.constant_acceleration
    assert motion is not None
    short = motion.model_copy(update={"acceleration_rps_s": 20.0, "end_rps": 2.0, "tail_s": 0.02})
    bench = bench.model_copy(update={"constant_acceleration": short, "settle_s": 0.02})
    for loop, period_s in (("drive", 0.002), ("host", 0.00025)):
        world = World(load_robot("reference"))
        with Session(bench, InProcessChannel(world, medium_for(world, None)), BusLog(None)) as session:
            session.bring_up()
            session.run(constant_acceleration(bench, 2, period_s), "notch", loop)


if __name__ == "__main__":
    if not is_there():
        make()
