"""The planar chain of the reference robot as an arm: the same links, joints counted the same way."""

from pathlib import Path

import numpy as np

from hil.bench.bench import REFERENCE, Bench, load_bench
from hil.control.trajectory import PlanarChain

CHAIN = PlanarChain(0.050, 0.330, 0.440, (0.420, 0.035), 0.130)
START = (0.50, 0.45)
HOME_DEG = np.degrees(CHAIN.joints(np.array(START))).tolist()

ARM = f"""
[arm]
tip_m = [0.130, 0.0, 0.0]
home_deg = {HOME_DEG}

[[arm.link]]
axis = 2
origin_m = [0.050, 0.0, 0.330]
direction = [0.0, 1.0, 0.0]

[[arm.link]]
axis = 3
origin_m = [0.0, 0.0, 0.440]
rpy_deg = [0.0, -90.0, 0.0]
direction = [0.0, -1.0, 0.0]

[[arm.link]]
axis = 5
origin_m = [0.420, 0.0, 0.035]
direction = [0.0, -1.0, 0.0]
"""


def text_with_arm(arm: str = ARM, **line: str) -> str:
    """The reference bench file with an arm instead of the geometry, and some lines of line_motion changed."""
    text = REFERENCE.read_text(encoding="utf-8")
    before, rest = text.split("[geometry]")
    _, after = rest.split("[line_motion]")
    lines = [row for row in before.splitlines() if not row.startswith(("tip_lever_m", "reference ="))]
    motion = after.splitlines()
    for key, value in line.items():
        motion = [row for row in motion if not row.startswith(f"{key} =")]
        motion.insert(1, f"{key} = {value}")
    return "\n".join([*lines, arm, "[line_motion]", *motion]) + "\n"


def bench_with_arm(folder: Path, arm: str = ARM, **line: str) -> Bench:
    """That bench, read from a file."""
    path = folder / "bench.toml"
    path.write_text(text_with_arm(arm, **line), encoding="utf-8")
    return load_bench(path)
