"""What CiA 402 lets a power drive system do, written from the standard's tables and not from the project's."""

COMMANDS = {  # mask, bits: the standard's table of control words
    "shutdown": (0x87, 0x06),
    "switch on": (0x8F, 0x07),
    "enable operation": (0x8F, 0x0F),
    "disable voltage": (0x82, 0x00),
    "quick stop": (0x86, 0x02),
}
STATUS = {  # mask, bits: the standard's table of status words
    "NOT_READY_TO_SWITCH_ON": (0x4F, 0x00),
    "SWITCH_ON_DISABLED": (0x4F, 0x40),
    "READY_TO_SWITCH_ON": (0x6F, 0x21),
    "SWITCHED_ON": (0x6F, 0x23),
    "OPERATION_ENABLED": (0x6F, 0x27),
    "QUICK_STOP_ACTIVE": (0x6F, 0x07),
    "FAULT_REACTION_ACTIVE": (0x4F, 0x0F),
    "FAULT": (0x4F, 0x08),
}
POWERED = {"OPERATION_ENABLED", "QUICK_STOP_ACTIVE", "FAULT_REACTION_ACTIVE"}
FAULTY = {"FAULT_REACTION_ACTIVE", "FAULT"}
BY_ITSELF = {
    "SWITCH_ON_DISABLED": {"FAULT"},
    "READY_TO_SWITCH_ON": {"FAULT", "SWITCH_ON_DISABLED"},
    "SWITCHED_ON": {"FAULT", "SWITCH_ON_DISABLED"},
    "OPERATION_ENABLED": {"QUICK_STOP_ACTIVE", "SWITCH_ON_DISABLED", *FAULTY},
    "QUICK_STOP_ACTIVE": {"SWITCH_ON_DISABLED", *FAULTY},
    "FAULT_REACTION_ACTIVE": {"FAULT"},
    "FAULT": set(),
}
"""Where a state leads without a control word: faults, ends of stops, 6007h and safe torque off. Never towards torque.

At the end of a stop the control word that came last acts as if it came then, if it came after the stop had begun.
"""
STAYS = range(5, 9)
"""605Ah: the drive stays in quick stop active, and transition 16 leads out of it."""


def command_of(word):
    """The name of a command, or None."""
    return next((name for name, (mask, bits) in COMMANDS.items() if word & mask == bits), None)


def state_shown(status_word):
    """The name of the state that a status word shows."""
    return next(name for name, (mask, bits) in STATUS.items() if status_word & mask == bits)


def arrows(state, word, previous, quick_stop_option):
    """The one transition that a control word asks for in a state: where it leads, or None."""
    command = command_of(word)
    if state == "FAULT":
        return "SWITCH_ON_DISABLED" if word & ~previous & 0x80 else None
    if state == "QUICK_STOP_ACTIVE" and command == "enable operation":
        return "OPERATION_ENABLED" if quick_stop_option in STAYS else None
    table = {
        "SWITCH_ON_DISABLED": {"shutdown": "READY_TO_SWITCH_ON"},
        "READY_TO_SWITCH_ON": {
            "switch on": "SWITCHED_ON", "enable operation": "SWITCHED_ON",
            "disable voltage": "SWITCH_ON_DISABLED", "quick stop": "SWITCH_ON_DISABLED",
        },
        "SWITCHED_ON": {
            "enable operation": "OPERATION_ENABLED", "shutdown": "READY_TO_SWITCH_ON",
            "disable voltage": "SWITCH_ON_DISABLED", "quick stop": "SWITCH_ON_DISABLED",
        },
        "OPERATION_ENABLED": {
            "switch on": "SWITCHED_ON", "shutdown": "READY_TO_SWITCH_ON",
            "disable voltage": "SWITCH_ON_DISABLED", "quick stop": "QUICK_STOP_ACTIVE",
        },
        "QUICK_STOP_ACTIVE": {"disable voltage": "SWITCH_ON_DISABLED"},
    }  # fmt: skip
    return table.get(state, {}).get(command)


class PowerOracle:
    """Follows a drive's state from outside: by the control words that come into force, and by what it shows.

    Args:
        state: At the beginning.
        is_exact: Whether each word must have acted when it is judged; a drive that takes its time is held to the rest alone.
    """

    def __init__(self, state, *, is_exact=True):
        self.state, self.is_exact = state, is_exact
        self.enabled = 0
        self._forget()

    def _forget(self):
        """No word from before a fault or a reset counts."""
        self.word, self._has_shutdown, self._has_switch_on, self._may_resume = 0, False, False, False
        self._leaving, self._is_fresh = set(), False

    def reset(self, state):
        """The node has been reset, or has got power."""
        assert state == "SWITCH_ON_DISABLED"
        self.state = state
        self._forget()

    def judge_word(self, word, before, after, *, quick_stop, shutdown, disable, has_voltage, may_energise):
        """A control word has come into force."""
        previous = self.word
        self.word = word
        is_stopping = before == "QUICK_STOP_ACTIVE" or (before == "OPERATION_ENABLED" and self._leaving)
        self._is_fresh = bool(is_stopping) and after == before
        self._count(word, before)
        if self.is_exact:
            allowed = self._allowed(word, previous, before, quick_stop, shutdown, disable, has_voltage)
            assert after in allowed, f"{before}: {previous:04X}h, {word:04X}h led to {after}, not to one of {sorted(allowed)}"
        if after == "OPERATION_ENABLED" != before:
            assert may_energise, "enabled without NMT Operational"
        self._step(before, after, is_by_word=True)

    def judge_itself(self, after):
        """A look at the state, between control words."""
        before = self.state
        if after == before:
            return
        if self.is_exact:
            allowed = BY_ITSELF[before] | (self._leaving if before == "OPERATION_ENABLED" else set())
            if self._is_fresh:
                ends = {"SWITCH_ON_DISABLED"} if before == "QUICK_STOP_ACTIVE" else self._leaving
                allowed |= {arrows(end, self.word, self.word, 0) for end in ends} - {None}
            assert after in allowed, f"{before} led to {after} by itself"
        assert not (before == "FAULT" and self.is_exact)
        self._step(before, after, is_by_word=False)

    def _count(self, word, state):
        command = command_of(word)
        if command == "shutdown":
            self._has_shutdown, self._has_switch_on = True, False
        elif command in {"switch on", "enable operation"}:
            self._has_switch_on = self._has_switch_on or self._has_shutdown
        elif command == "quick stop" and state == "OPERATION_ENABLED":
            self._may_resume = True
        elif self.is_exact and command in {"disable voltage", "quick stop"} and state not in {"QUICK_STOP_ACTIVE"} | FAULTY:
            # a drive that takes its time may never have seen it: of the words of a transition the last counts
            self._has_shutdown = self._has_switch_on = self._may_resume = False

    def _allowed(self, word, previous, before, quick_stop, shutdown, disable, has_voltage):
        after = arrows(before, word, previous, quick_stop)
        if after is None or (after == "READY_TO_SWITCH_ON" and before == "SWITCH_ON_DISABLED" and not has_voltage):
            return {before}
        if before == "READY_TO_SWITCH_ON" and command_of(word) == "enable operation":
            return {"SWITCHED_ON", "OPERATION_ENABLED"}
        if after == "OPERATION_ENABLED":
            return {before, after}
        ramp = shutdown if after == "READY_TO_SWITCH_ON" else disable
        if before == "OPERATION_ENABLED" and after in {"SWITCHED_ON", "READY_TO_SWITCH_ON"} and ramp == 1:
            self._leaving = {after}
            return {before, after}
        return {after, "SWITCH_ON_DISABLED"} if after == "QUICK_STOP_ACTIVE" else {after}

    def _step(self, before, after, *, is_by_word):
        self.state = after
        if after == before:
            return
        if after == "OPERATION_ENABLED":
            assert command_of(self.word) == "enable operation"
            if before == "QUICK_STOP_ACTIVE":
                assert self._may_resume, "transition 16 without a quick stop of this life"
            else:
                assert self._has_shutdown, "enabled without shutdown since the last fault or reset"
                assert self._has_switch_on, "enabled without switch on since the last fault or reset"
            assert is_by_word or not self.is_exact
            self.enabled += 1
            self._leaving = set()
        if after in FAULTY:
            word = self.word
            self._forget()
            self.word = word
        if after == "QUICK_STOP_ACTIVE":
            self._may_resume = True
