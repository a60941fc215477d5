"""The picture of docs/recordings.md: order spectra of four joints of a real robot, from the recordings beside this file.

python examples/lara8/picture.py
"""

import tempfile
from pathlib import Path

from hil.experiments.ate.recorded.identify import identify_recorded
from hil.experiments.ate.recorded.request import RecordedRequest
from hil.recording import load_columns
from hil.recordings import Said
from hil.report import style
from hil.report.svg import standalone

HERE = Path(__file__).parent
JOINTS = {1: "joint_1_and_6.csv.gz", 2: "joint_2.csv.gz", 3: "joint_3.csv.gz", 6: "joint_1_and_6.csv.gz"}
TITLE = "Order spectra of four joints of a NEURA LARA 8: order 2 is the highest in each"


def draw() -> str:
    """The picture as SVG."""
    figure, panels = style.panels(2, 2, 4.2, sharex=True)
    for (joint, name), panel in zip(JOINTS.items(), panels.flat, strict=True):
        with tempfile.TemporaryDirectory() as place:
            result = identify_recorded(RecordedRequest((HERE / name,), joint, Said()), Path(place))
            curve = load_columns(Path(place) / "scan.csv")
        panel.plot(curve["order"], curve["amplitude"], label="amplitude", **style.MEASURED)
        panel.plot(curve["order"], curve["level"], label="false alarm in 1 % of scans", **style.LIMIT)
        highest = result.scan.highest
        panel.annotate(
            f"order {highest.order:.2f}", (highest.order, highest.amplitude), xytext=(5, -2), textcoords="offset points",
            va="top", fontsize=8.0,
        )  # fmt: skip
        turns = sum(each.turns for each in result.stretches)
        panel.set_title(f"joint {joint}, N = {result.reduction_ratio:g}, {turns:.0f} motor revolutions")
        panel.set(xlim=(0.6, 10.0), ylim=(0.0, None))
        panel.set_xticks(range(1, 11))
    for panel in panels[:, 0]:
        panel.set_ylabel("Amplitude (arcsec)")
    for panel in panels[1, :]:
        panel.set_xlabel("Order k (per motor revolution)")
    style.legend_above(figure, panels[0, 0])
    return standalone(str(style.to_svg(figure, "lara8")), TITLE)


if __name__ == "__main__":
    with style.styled():
        (HERE.parents[1] / "docs" / "recordings.svg").write_text(draw(), encoding="utf-8")
