"""Picture of a finding in a log."""

from hil.logs.findings.finding import Finding
from hil.report import style
from hil.report.style import Drawing


def finding_picture(finding: Finding, number: int) -> Drawing | None:
    """Draw the numbers behind a finding; None without any.

    Args:
        finding: The finding.
        number: Its number on the page, from 1.
    """
    picture = finding.picture
    if picture is None or not len(picture.x):
        return None
    key = f"finding-{number}"
    figure, panels = style.panels(1, 1, 2.2)
    panel = panels[0, 0]
    mode = {"linewidth": 0.9} if picture.is_line else {"linestyle": "", "marker": ".", "markersize": 2.5}
    panel.plot(picture.x, picture.y, color=style.BLUE, **mode)
    for stamp in finding.stamps_s:
        panel.axvline(stamp, color=style.VERMILLION, linewidth=0.7, alpha=0.6)
    for name, value in picture.limits:
        panel.axhline(value, **style.MARK)
        panel.annotate(name, (1.0, value), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize="small")
    panel.set(xlabel=picture.x_label, ylabel=picture.y_label)
    said = f"{finding.words[:1].upper()}{finding.words[1:]}"
    words = f"{said}. Vertical lines: the first {len(finding.stamps_s)} of {finding.count} occurrences."
    return Drawing(key, f"{number}. {finding.kind}", "", "measured", words, style.to_svg(figure, key))
