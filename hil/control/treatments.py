"""Treatments of the vibration by name, as data."""

from dataclasses import dataclass
from typing import Literal, cast

LoopName = Literal["drive", "host"]
"""The place where the loop is closed."""

ShaperName = Literal["zv", "zvd", "mzv", "ei", "two-hump-ei"]
"""Input shapers: `hil.control.shapers`."""

TreatmentName = Literal[
    "none",
    "low-gains",
    "fixed-notch",
    "notch",
    "notch-designed",
    "cancellation",
    "cancellation+notch",
    "cancellation-inside",
    "cancellation-learnt",
    "cancellation-following",
    "shaper-zv",
    "shaper-zvd",
    "shaper-mzv",
    "shaper-ei",
    "shaper-two-hump-ei",
    "cancellation+shaper-zv",
    "cancellation+shaper-zvd",
    "cancellation+shaper-mzv",
    "cancellation+shaper-ei",
    "cancellation+shaper-two-hump-ei",
]

PlainTreatmentName = Literal["none", "notch"]
"""Names of the treatments that are plain: `Treatment.is_plain`."""


@dataclass(frozen=True)
class Treatment:
    """A treatment of the vibration.

    Attributes:
        name: Its name on the command line, in results and in the names of recordings.
        title: A few words for tables and figures.
        filters: `variable`: the filters follow the speed; `fixed`: filters that stay where they are; empty: none act.
        cancels: `set-points`: an addition to the set-points cancels the error; `inside`: the drives do it in their own loops.
        shaper: Input shaper that acts on the set-points; None without one.
        gain_factor: Factor of all three gains.
        needs: Knowledge beside the gains and filters of a bench or robot file. `model`: of the plant and its error, from a
            model file or the bench file; `design`: a design file; `learnt`: a model file of `hil learn`.
        follows: True if amplitudes and phases follow what is left of the vibration during the motion.
    """

    name: TreatmentName
    title: str
    filters: Literal["", "variable", "fixed"] = ""
    cancels: Literal["", "set-points", "inside"] = ""
    shaper: ShaperName | None = None
    gain_factor: float = 1.0
    loops: tuple[LoopName, ...] = ("drive", "host")
    needs: Literal["", "model", "design", "learnt"] = ""
    follows: bool = False

    @property
    def is_plain(self) -> bool:
        """True if a bench or robot file says everything.

        Its gains stay: the filters act or they do not.
        """
        return not self.needs and self.gain_factor == 1.0

    @property
    def is_shaper(self) -> bool:
        """True if a shaper acts, and nothing beside it."""
        return self.shaper is not None and not self.cancels

    @property
    def is_remedy(self) -> bool:
        """True if the tip is meant to keep the specification."""
        return self.filters == "variable" or bool(self.cancels)


_SHAPERS: dict[ShaperName, str] = {"zv": "ZV", "zvd": "ZVD", "mzv": "MZV", "ei": "EI", "two-hump-ei": "two-hump EI"}

TABLE: tuple[Treatment, ...] = (
    Treatment("none", "untreated"),
    Treatment("low-gains", "gains halved", gain_factor=0.5),  # about what an engineer takes back until the arm is quiet
    Treatment("fixed-notch", "fixed notch", filters="fixed", loops=("host",), needs="model"),
    Treatment("notch", "notch", filters="variable"),
    Treatment("notch-designed", "designed notch", filters="variable", needs="design"),
    Treatment("cancellation", "cancellation", cancels="set-points", loops=("drive",), needs="model"),
    Treatment(
        "cancellation+notch",
        "cancellation and notch",
        filters="variable",
        cancels="set-points",
        loops=("drive",),
        needs="model",
    ),
    Treatment(
        "cancellation-inside",
        "cancellation in the drives",
        cancels="inside",
        loops=("drive",),
        needs="model",
    ),
    Treatment(
        "cancellation-learnt",
        "learnt cancellation",
        cancels="set-points",
        loops=("drive",),
        needs="learnt",
    ),
    Treatment(
        "cancellation-following",
        "cancellation that follows",
        cancels="set-points",
        loops=("drive",),
        needs="model",
        follows=True,
    ),
    *(
        Treatment(cast("TreatmentName", f"shaper-{name}"), f"{words} shaper", shaper=name, loops=("drive",), needs="model")
        for name, words in _SHAPERS.items()
    ),
    *(
        Treatment(
            cast("TreatmentName", f"cancellation+shaper-{name}"),
            f"cancellation and {words} shaper",
            cancels="set-points",
            shaper=name,
            loops=("drive",),
            needs="model",
        )
        for name, words in _SHAPERS.items()
    ),
)

_ROWS: dict[str, Treatment] = {each.name: each for each in TABLE}


def treatment(name: str) -> Treatment:
    """Return the row of a treatment by its name.

    Raises:
        ValueError: No treatment has that name.
    """
    try:
        return _ROWS[name]
    except KeyError:
        raise ValueError(f"no treatment {name!r}; expected one of {', '.join(_ROWS)}") from None
