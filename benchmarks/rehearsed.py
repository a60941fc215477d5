"""One robot's rehearsal: processor time of the documented path, step by step."""

from benchmarks.measure import Row, progress, table, turns
from plant_emulator.rehearsal.many.one import run_seed

ROBOTS = (("linear", 1), ("real", 2), ("linear", 3), ("real", 4))
STEPS = ("plant", "ate", "design", "learn")
NEVER = 1_000_000_000
"""Wrong corrections are tried on every so many robots: on none here."""


def rehearsed() -> list[str]:
    """Processor seconds of drawn robots' paths, and the part of each identification in them.

    Raises:
        RuntimeError: A path broke.
    """
    rows: list[Row] = []
    for kind, seed in ROBOTS[: turns(len(ROBOTS))]:
        progress(f"rehearsal: {kind} robot {seed}")
        row = run_seed(seed, kind, over_bus=False, probed_every=NEVER)
        if row["walk_words"]:
            raise RuntimeError(f"the path of {kind} robot {seed} broke: {row['walk_words']}")
        whole = float(row["cpu_s"] or 0.0)
        parts = [float(row[f"{step}_cpu_s"] or 0.0) / whole for step in STEPS]
        rows.append((f"{kind}, seed {seed}", whole, *parts, 1.0 - sum(parts)))
    return table(("robot", "processor time, s", *STEPS, "runs and the rest"), rows)
