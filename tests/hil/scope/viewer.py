"""A viewer of the page's stream that is no browser."""

import asyncio
import json

import numpy as np
from tornado.websocket import websocket_connect

from hil.scope.server import SPECTRUM


async def leave(connection):
    """Close a stream, and wait until it is."""
    connection.close()
    while await connection.read_message() is not None:
        pass


class Viewer:
    """A viewer that is no browser."""

    def __init__(self, connection):
        self._connection = connection
        self.rows, self.said = [], []

    async def until(self, done):
        while not done(self):
            message = await asyncio.wait_for(self._connection.read_message(), 20)
            if message is None:
                return self
            if isinstance(message, str):
                self.said.append(json.loads(message))
            else:
                numbers = np.frombuffer(message, "<f8")
                first, count, width = (int(each) for each in numbers[:3])
                if first == SPECTRUM:
                    self.said.append({"kind": "spectrum", "x": numbers[3 : 3 + count], "y": numbers[3 + count :]})
                    continue
                self.rows.append((first, numbers[3 : 3 + count], numbers[3 + count :].reshape(width, count)))
        return self

    def kinds(self):
        return [each["kind"] for each in self.said]

    @property
    def names(self):
        return [each["name"] for each in [one for one in self.said if one["kind"] == "layout"][-1]["signals"]]


def look(scope, talk, run=""):
    async def joined():
        connection = await websocket_connect(scope.url.replace("http", "ws") + "stream" + run)
        viewer = Viewer(connection)
        try:
            return await talk(viewer, connection)
        finally:
            await leave(connection)

    return asyncio.run(joined())


def all_rows_of(name, count):
    """A talk that waits for so many rows, and has times and values of one signal; shapes (n,)."""

    async def talk(viewer, _):
        await viewer.until(lambda one: one.rows and one.rows[-1][0] + len(one.rows[-1][1]) >= count)
        column = viewer.names.index(name)
        rows = {first: (times, values[column]) for first, times, values in viewer.rows if len(values) > column}
        found = [rows[first] for first in sorted(rows)]
        return np.concatenate([times for times, _ in found]), np.concatenate([values for _, values in found])

    return talk
