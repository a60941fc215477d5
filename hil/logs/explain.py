"""Explanation of a log: findings, worst first, and open questions."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from drive_profiles.eds.description import Description
from hil.logs.findings.answers import answer_findings, node_findings
from hil.logs.findings.bus import bus_findings, sender_findings
from hil.logs.findings.finding import Finding, Said, Untold, together
from hil.logs.findings.orders import order_findings
from hil.logs.findings.path import path_findings
from hil.logs.findings.set_points import set_point_findings
from hil.logs.findings.starving import starving_findings, sync_findings
from hil.logs.findings.states import state_findings
from hil.logs.log import Log
from hil.logs.trace import Trace


@dataclass(frozen=True)
class Explanation:
    """Contents of a log in words.

    Attributes:
        findings: Findings, worst first; equally bad ones in their order of time.
    """

    trace: Trace
    findings: tuple[Finding, ...]
    unknown: tuple[Untold, ...]


def explain(log: Log, descriptions: Mapping[int, Description], bitrate: int | None = None) -> Explanation:
    """Look through a log."""
    trace = Trace(log, descriptions)
    said = [*bus_findings(trace, bitrate), *node_findings(trace)]
    said += together(map(_of_part, trace.parts))
    findings = [each for each in said if isinstance(each, Finding)]
    findings.sort(key=lambda each: (-each.severity, min(each.stamps_s, default=0.0)))
    return Explanation(trace, tuple(findings), tuple(each for each in said if isinstance(each, Untold)))


def _of_part(trace: Trace) -> Iterator[Said]:
    """What depends on the cycle and the mapping of a part."""
    yield from sync_findings(trace)
    yield from sender_findings(trace)
    yield from set_point_findings(trace)
    yield from path_findings(trace)
    yield from order_findings(trace)
    yield from answer_findings(trace)
    yield from starving_findings(trace)
    yield from state_findings(trace)
