"""The live page on SocketCAN: as a listener it has every row, by the kernel's stamps, and says when the interface goes."""

import contextlib

import numpy as np
import pytest

from hil.can.listening import CanListener
from hil.can.socketcan import SocketCanChannel
from hil.scope import process
from tests.hil.scope.traffic import Traffic, played
from tests.hil.scope.viewer import all_rows_of, look
from tests.vcan.conftest import START_TIMEOUT_S, SYNC_PERIOD_S, ip

pytestmark = pytest.mark.vcan
CYCLES = 120


async def until_it_ends(viewer, _):
    await viewer.until(lambda one: "ended" in one.kinds())
    return next(each["words"] for each in viewer.said if each["kind"] == "ended")


def test_a_scope_shows_every_row_and_sends_nothing(spare, monkeypatch):
    monkeypatch.setattr(process, "SCOPE_START_S", START_TIMEOUT_S)
    traffic = Traffic((41, 42), round(1e9 * SYNC_PERIOD_S)).set_up().run(CYCLES).heard()
    with (
        process.ScopeProcess(str(spare), "reference", 0) as scope,
        contextlib.closing(CanListener(spare)) as stranger,
        contextlib.closing(SocketCanChannel(spare)) as channel,
    ):
        played(channel, traffic, 200.0)
        time_s, values = look(scope, all_rows_of("node 42 position", CYCLES - 1))
        assert values == pytest.approx(np.arange(CYCLES - 1) / 1000)
        assert (np.diff(time_s) > 0.0).all()
        assert time_s[-1] - time_s[0] > 0.5 * CYCLES * SYNC_PERIOD_S  # the kernel's clock, not one of ours
        heard = stranger.take()
        assert heard["can_id"].tolist() == traffic["can_id"].tolist()
        ip("link", "set", spare.channel, "down")
        assert "down" in look(scope, until_it_ends).lower()
