"""Motor inertia for a cancellation, and the words if it is unknown."""

from collections.abc import Sequence

from hil.bench.bench import Bench
from hil.bench.model import Identified
from hil.errors import NotPossibleError


def given_inertia(bench: Bench, identified: Identified | None, number: int, given_kg_m2: float | None) -> float | None:
    """Motor inertia J_m from bench file or data sheet.

    It is None if a file has a plant, whose inertia then holds.

    Args:
        given_kg_m2: J_m of a data sheet; None: as the bench file gives it.

    Raises:
        NotPossibleError: The inertia is not known.
    """
    known = None if identified is None else identified.axis.get(number)
    if bench.axis[number].model is not None or (known is not None and known.plant is not None):
        return None
    found = bench.axis[number].motor_inertia_kg_m2 if given_kg_m2 is None else given_kg_m2
    if found is None:
        raise NotPossibleError(
            f"the motor inertia of axis {number} is not known, and a cancellation needs it; give --plant "
            f"model.toml of hil identify plant, or [axis.{number}.model] in the bench file. Otherwise take it from the motor's "
            f"data sheet: motor_inertia_kg_m2 in [axis.{number}], or --motor-inertia-kg-m2"
        )
    return found


def nothing_known(bench: Bench, identified: Identified | None, axes: Sequence[int]) -> str:
    """Describe why axes cannot be cancelled."""
    for number in axes:
        known, table = None if identified is None else identified.axis.get(number), bench.axis[number]
        error = None if known is None or known.plant is not None or table.model is not None else known.ate
        if error is not None and error.motor_inertia_kg_m2 is None and table.motor_inertia_kg_m2 is None:
            return (
                f"the motor inertia of axis {number} is not known, and a cancellation needs it; run hil identify plant, or "
                f"state motor_inertia_kg_m2 of its data sheet in [axis.{number}]"
            )
    names = " or ".join(map(str, axes))
    return f"no transmission error is known of axis {names}; hil identify ate finds it, or a model in the bench file states it"
