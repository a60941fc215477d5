"""Explanation of a log: findings, worst first, and open questions."""

from collections.abc import Mapping
from dataclasses import dataclass

from drive_profiles.eds.description import Description
from hil.logs.findings.answers import answer_findings
from hil.logs.findings.bus import bus_findings
from hil.logs.findings.finding import Finding, Untold
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
        trace: The log that was looked through.
        findings: Findings, worst first; equally bad ones in their order of time.
        unknown: Questions that it cannot answer.
    """

    trace: Trace
    findings: tuple[Finding, ...]
    unknown: tuple[Untold, ...]


def explain(log: Log, descriptions: Mapping[int, Description], bitrate: int | None = None) -> Explanation:
    """Look through a log."""
    trace = Trace(log, descriptions)
    said = [
        *bus_findings(trace, bitrate),
        *sync_findings(trace),
        *set_point_findings(trace),
        *path_findings(trace),
        *order_findings(trace),
        *answer_findings(trace),
        *starving_findings(trace),
        *state_findings(trace),
    ]
    findings = [each for each in said if isinstance(each, Finding)]
    findings.sort(key=lambda each: (-each.severity, min(each.stamps_s, default=0.0)))
    return Explanation(trace, tuple(findings), tuple(each for each in said if isinstance(each, Untold)))
