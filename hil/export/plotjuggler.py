"""PlotJuggler's stream, and a layout of its plots.

A JSON object for each row, by UDP, at the recording's own pace.

Source: PlotJuggler, UDP Server plugin with the JSON protocol: keys become curves under "/"; `timestamp` is the time.
"""

import heapq
import socket
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from xml.etree import ElementTree as Xml

from hil.export.series import Series, unit_of
from hil.export.tables import in_words

STAMP_KEY = "timestamp"
COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#ff7f0e", "#9467bd", "#8c564b", "#17becf", "#e377c2")


def send(
    series: Sequence[Series], host: str, port: int, speed: float = 1.0, progress: Callable[[int], None] = lambda rows: None
) -> int:
    """Send rows to a listening program; return their number.

    `speed` is the pace in times of the recording's own; `progress` gets the rows that have been sent.

    Raises:
        OSError: The name is not known, or the network refuses.
    """
    family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    rows = heapq.merge(
        *(zip(each.time_s.tolist(), in_words(each, STAMP_KEY), strict=True) for each in series), key=lambda row: row[0]
    )
    sent = 0
    with socket.socket(family, kind, protocol) as sender:
        begin = first = None
        for stamp, text in rows:
            if begin is None or first is None:
                begin, first = time.monotonic(), stamp
            wait = begin + (stamp - first) / speed - time.monotonic()
            if wait > 0.0:
                time.sleep(wait)
            sender.sendto(text.encode(), address)
            sent += 1
            progress(1)
    return sent


def write_layout(path: Path, series: Sequence[Series]) -> None:
    """Write a layout: a plot for each unit, its columns as curves."""
    by_unit: dict[str, list[str]] = {}
    for each in series:
        for name in each.columns:
            by_unit.setdefault(unit_of(name), []).append(name)
    root = Xml.Element("root")
    widget = Xml.SubElement(root, "tabbed_widget", {"parent": "main_window", "name": "Main Window"})
    tab = Xml.SubElement(widget, "Tab", tab_name="hil", containers="1")
    sizes = ";".join(f"{1.0 / len(by_unit):.6g}" for _ in by_unit)
    container = Xml.SubElement(tab, "Container")
    splitter = Xml.SubElement(container, "DockSplitter", orientation="-", count=str(len(by_unit)), sizes=sizes)
    for unit, names in by_unit.items():
        area = Xml.SubElement(splitter, "DockArea", name=unit or "without unit")
        plot = Xml.SubElement(area, "plot", style="Lines", mode="TimeSeries", flip_x="false", flip_y="false")
        for number, name in enumerate(names):
            Xml.SubElement(plot, "curve", name=f"/{name}", color=COLOURS[number % len(COLOURS)])
    Xml.SubElement(widget, "currentTabIndex", index="0")
    Xml.indent(root)
    Xml.ElementTree(root).write(path, encoding="UTF-8", xml_declaration=True)
