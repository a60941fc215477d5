"""Figure of a cancellation that follows: amplitudes and phases over the motion."""

import itertools

from hil.report import style
from hil.report.material import Material, run_name
from hil.report.style import Drawing


def following(material: Material) -> Drawing | None:
    """Draw amplitude factor and phase shift of each order over the motion."""
    runs = {run.recording: run for run in material.result.runs if run.following is not None and run.following.orders}
    if not runs:
        return None
    run = next(iter(runs.values()))
    orders = () if run.following is None else run.following.orders
    figure, panels = style.panels(2, 1, 3.2, sharex=True)
    top, bottom = panels[:, 0]
    for each, look in zip(orders, itertools.cycle(style.AXIS_LINES)):
        name = f"axis {each.axis}, order {each.order:g}"
        top.plot(each.time_s, [size / each.amplitude_start_arcsec for size in each.amplitude_arcsec], label=name, **look)
        bottom.plot(each.time_s, [phase - each.phase_deg[0] for phase in each.phase_deg], label=name, **look)
    top.set_ylabel("Factor of A")
    bottom.set(xlabel="Time (s)", ylabel="Change of φ (°)")
    style.legend_above(figure, top)
    return Drawing(
        "following",
        f"{run_name(run, with_window=False)}: amplitude and phase as the cancellation followed them",
        "",
        "measured",
        "Amplitude and phase of each cancelled order, relative to the identified ones. They are held at rest, while the "
        "motion's own jerks shake the tip, and while an order does not exceed the sensor's noise. "
        + " ".join(f"{each.words}." for each in orders),
        style.to_svg(figure, "following"),
    )
