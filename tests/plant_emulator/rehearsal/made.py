"""Rows as walks give them, made by the record of a walk itself: a robot that is cured, and what may differ."""

from plant_emulator.rehearsal.many.claims import claims_of
from plant_emulator.rehearsal.many.page import sections, write_page
from plant_emulator.rehearsal.many.rows import WALKED
from plant_emulator.rehearsal.record import FACTS, STEPS, PathRecord, ProbeRecord, QuantityRecord, StepRecord
from plant_emulator.trials.rows import plain

FACT_VALUES = {
    "reduction_ratio": 100.0, "antiresonance_hz": 10.0, "f_al_hz": 9.5, "inertia_ratio": 2.0, "a1_arcsec": 20.0,
    "a2_arcsec": 20.0, "a4_arcsec": 5.0, "encoder_bits": 17.0, "current_lag_s": 0.0, "hysteresis_nm": 0.0, "softness": 0.0,
    "gear_reaction": False, "noise_m_s2": 0.02, "sensor_delay_s": 0.002, "mounting_hz": 200.0, "sync_period_s": 0.002,
    "late_answers": False, "bitrate": 1_000_000,
}  # fmt: skip
CURED = {
    "none": {1: 0.30, 2: 0.20, 4: 0.05},
    "notch": {1: 0.30, 2: 0.18, 4: 0.05},
    "notch_designed": {1: 0.30, 2: 0.10, 4: 0.05},
    "cancellation": {1: 0.008, 2: 0.009, 4: 0.004},
    "cancellation_learnt": {1: 0.006, 2: 0.007, 4: 0.003},
}
FLOOR = {1: 0.001, 2: 0.002, 4: 0.001}


def row(
    seed, kind="linear", *, ended=None, words=None, causes=None, tips=None, facts=None, quantities=None, probes=None, cpu_s=10.0
):
    """A row of a robot that is cured, but for what is given.

    Args:
        seed: Seed of the robot.
        kind: Kind of the robot.
        ended: End of a step, by its name; the others are done.
        words: Words of a step, by its name.
        causes: Causes that a step's error names, by the step's name.
        tips: True tips of a treatment, by its name; the others are `CURED`'s.
        facts: Facts that differ.
        quantities: Truth, estimate and standard error, by the quantity's name.
        probes: Wrong corrections, by name: whether they were accepted.
        cpu_s: Processor time.
    """
    record = PathRecord(f"fleet-{kind}-{seed}", seed, 2)
    record.facts = FACT_VALUES | (facts or {})
    assert set(record.facts) >= set(FACTS)
    for step in STEPS:
        end = (ended or {}).get(step, "done")
        record.steps[step] = StepRecord(
            end, "" if end == "done" else "HilError", (words or {}).get(step, ""), 0.1, (causes or {}).get(step, ())
        )
    record.tips = CURED | (tips or {})
    record.floor = dict(FLOOR)
    record.quantities = {name: QuantityRecord(*values) for name, values in (quantities or {}).items()}
    record.probes = {name: ProbeRecord(accepted, 2.0 if accepted else None) for name, accepted in (probes or {}).items()}
    record.cpu_s = cpu_s
    cells = {"seed": seed, "kind": kind, "walk": WALKED, "walk_words": ""} | record.row() | {"version": "0.1.0"}
    return {name: plain(value) for name, value in cells.items()}


REFUSED = dict.fromkeys(("ate", "learn"), "refused") | dict.fromkeys(("cancellation", "cancellation_learnt"), "skipped")


def refused(seed, words, kind="linear", causes=(), **differs):
    """A row of a robot whose error was not identified: with these words and causes, by both steps that could."""
    ended = {**REFUSED, "design": "refused", "notch_designed": "skipped"}
    return row(seed, kind, ended=ended, words={"ate": words, "learn": words}, causes={"ate": causes, "learn": causes}, **differs)


def page_of(path, rows):
    """Write the page of robots; return its path."""
    found = claims_of(rows)
    return write_page(path, rows, found, sections(rows, found))
