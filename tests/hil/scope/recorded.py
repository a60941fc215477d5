"""A scope of recordings, as a process of its own."""

import sys

from hil.scope.process import ScopeProcess


class RecordedScope(ScopeProcess):
    """The page of a folder."""

    def __init__(self, folder):
        super().__init__("", "", 0)
        self._command = [sys.executable, "-m", "hil", "scope", str(folder), "--port", "0", "--until-stdin-closes"]
