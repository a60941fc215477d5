"""One fault at any frame of an upload of 60 objects: what the tool then states is what the node holds."""

import contextlib

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from drive_profiles.errors import DriveProfileError
from drive_profiles.parameter_set.parameters import Item, ParameterSet
from drive_profiles.standard.cia301 import encode
from drive_profiles.standard.object_address import object_address
from drive_profiles.upload import journal
from tests.drive_profiles import upload_rig as rig

CLEAN = rig.node()
BEFORE = rig.contents(CLEAN)


@pytest.fixture(scope="module")
def after(tmp_path_factory):
    slave = rig.node()
    line, outcome = rig.transfer(slave, tmp_path_factory.mktemp("clean"), store=True)
    assert outcome is not None
    assert outcome.kind == "done"
    assert outcome.stored == "yes"
    return rig.contents(slave), line.frames


def changed(after):
    return {place for place in BEFORE if BEFORE[place] != after[place]}


@pytest.mark.ci
def test_a_clean_upload_writes_sixty_objects_and_nothing_else(after):
    contents, _ = after
    differing = changed(contents)
    assert len(differing) >= 58  # of the PDO some were what they shall be
    assert contents[0x2200, 0] == 77
    assert contents[0x2100, 0] == "what it shall be from now on"
    assert contents[0x1601, 2] == 0x2201_0010


def check(fault, after, folder):
    """Run with the fault, and hold the statement against the node."""
    contents, _ = after
    slave = rig.node()
    try:
        _, outcome = rig.transfer(slave, folder, fault, store=True)
    except DriveProfileError as error:
        refusal = str(error)
    else:
        refusal = ""
    if refusal:
        held = rig.contents(slave)
        # refused before the first write: nothing has changed, unless the message says what has
        assert all(held[place] == BEFORE[place] or f"{place[0]:04X}:{place[1]:X}" in refusal for place in BEFORE), refusal
        assert not any(folder.glob("*.jsonl"))
        return "refused"
    held = rig.contents(slave)
    unknown = {object_address(text.split(" ")[0]) for text in outcome.unknown}
    if outcome.kind == "done" or unknown == {(0x1010, 1)}:
        assert held == contents
    else:
        wrong = {place: (held[place], BEFORE[place]) for place in BEFORE if held[place] != BEFORE[place] and place not in unknown}
        assert not wrong, (outcome, wrong)
    if outcome.stored != "unknown":
        kept = slave.store.stored.get((0x2001, 1), BEFORE[0x2001, 1])
        assert kept == (contents if outcome.stored == "yes" else BEFORE)[0x2001, 1], outcome
    [path] = folder.glob("*.jsonl")
    statement = journal.read(path)
    assert statement.outcome == outcome.kind
    for place, possible in statement.possible.items():
        if place not in unknown:
            cell = slave.dictionary.cell(*place)
            assert encode(cell.entry.data_type, held[place]) in possible, (outcome, place)
    return outcome.kind


KINDS = ("lost", "duplicated", "aborted", "corrupted")


def faults(kind, number):
    if kind != "corrupted":
        return [rig.Fault(kind, number)]
    # one bit of the command, and one of the object's address or of the data: which ones goes with the frame's number, so that
    # each has its turn while sixty objects pass in equal frames
    bit = 1 << (number + number // 8) % 8
    return [rig.Fault(kind, number, where, bit) for where in (0, (1, 3, 4, 7)[number // 2 % 4])]


EVERY = [
    pytest.param(1, marks=pytest.mark.slow, id="every frame"),
    pytest.param(9, marks=pytest.mark.part, id="every ninth frame"),
]


@pytest.mark.ci
@pytest.mark.parametrize("step", EVERY)
@pytest.mark.parametrize("kind", KINDS)
def test_one_disturbed_frame_leaves_the_node_as_is_stated(kind, step, after, tmp_path):
    _, frames = after
    seen = set()
    for number in range(0, frames, step):
        for place, fault in enumerate(faults(kind, number)):
            seen.add(check(fault, after, tmp_path / f"{number}-{place}"))
    assert ("done" if kind == "duplicated" else "rolled back") in seen
    assert seen <= {"refused", "done", "rolled back", "unknown"}


@pytest.mark.ci
@pytest.mark.parametrize("step", EVERY)
@pytest.mark.parametrize("kind", ["killed before", "killed after"])
def test_of_a_tool_that_is_killed_at_any_frame_the_journal_states_what_the_node_holds(kind, step, after, tmp_path):
    contents, frames = after
    uncertain = 0
    for number in range(0, frames, step):
        slave, folder = rig.node(), tmp_path / str(number)
        with contextlib.suppress(rig.KilledError):
            rig.transfer(slave, folder, rig.Fault(kind, number), store=True)
            pytest.fail("it was not killed")
        slave.advance(10_000_000_000)  # whatever the node was at is over
        held = rig.contents(slave)
        paths = list(folder.glob("*.jsonl"))
        if not paths:
            assert held == BEFORE
            continue
        statement = journal.read(paths[0])
        for place in BEFORE:
            data = encode(slave.dictionary.cell(*place).entry.data_type, held[place])
            assert data in statement.possible.get(place, {data} if held[place] == BEFORE[place] else set()), (number, place)
        assert len(statement.uncertain) <= 1
        uncertain += len(statement.uncertain)
        if statement.stored != "unknown":
            assert bool(slave.store.stored) == (statement.stored == "yes")
    assert uncertain > 50 // step
    assert contents != BEFORE


def test_a_link_that_is_cut_leaves_what_was_touched_unknown_and_says_so(after, tmp_path):
    contents, frames = after
    for number in range(150, frames, 37):
        slave, folder = rig.node(), tmp_path / str(number)
        line = rig.Line(slave)

        def cut(count, line=line, limit=number):
            if count >= limit:
                line.fault = rig.Fault("lost", count)

        line.on_frame = cut
        device = rig.Device(rig.SdoPort(rig.NODE, line, 0.01), rig.Catalogue(rig.PROFILE))
        upload = rig.Upload(device, rig.wanted(), rig.UploadOptions(store=True, journals=folder))
        try:
            rig.fleet.prepare([upload])
        except DriveProfileError:
            assert rig.contents(slave) == BEFORE
            continue
        [outcome] = rig.fleet.run([upload])
        held = rig.contents(slave)
        unknown = {object_address(text.split(" ")[0]) for text in outcome.unknown}
        if held == contents and not unknown - {(0x1010, 1)}:
            continue
        assert outcome.kind == "unknown"
        assert all(held[place] == BEFORE[place] for place in BEFORE if place not in unknown)


ONE = ParameterSet(tuning={"p1": Item(value=101)})
TWO = ParameterSet(tuning={"p1": Item(value=101), "p0": Item(value=100)})
TEXT = ParameterSet(tuning={"text": Item(value="what it shall be from now on")})


def truth(seed, parameter_set, folder, *, lost=0.0, refuses=None, store=False):
    """An upload over answers that are late; what it states is what the node holds, in the end."""
    slave = rig.node()
    line = rig.Late(slave, seed, lost=lost)
    if refuses is not None:
        slave.dictionary.on_write(*refuses, lambda value: 0x0609_0030)
    try:
        made = rig.upload(slave, folder, parameter_set, line, store=store)
        line.calm = 6 + seed % 4  # the last looks at what it holds, and all that follows
        [outcome] = rig.fleet.run([made])
    except DriveProfileError:
        assert rig.contents(slave) == BEFORE
        return "refused"
    line.receive(10.0)
    held = rig.contents(slave)
    unknown = {object_address(text.split(" ")[0]) for text in outcome.unknown}
    goal = {write.address: write.data for write in made.writes}
    for place in BEFORE:
        data = encode(slave.dictionary.cell(*place).entry.data_type, held[place])
        if outcome.others == "new" and place in goal:
            assert data == goal[place] or place in unknown, (seed, outcome)
        else:
            assert held[place] == BEFORE[place] or place in unknown, (seed, outcome)
    if outcome.stored in {"yes", "no"}:
        assert bool(slave.store.stored) == (outcome.stored == "yes"), (seed, outcome)
    return outcome.kind


@pytest.mark.parametrize(
    ("parameter_set", "refuses", "store"),
    [
        pytest.param(ONE, None, False, id="one", marks=pytest.mark.ci),
        pytest.param(TWO, None, False, id="two", marks=pytest.mark.ci),
        pytest.param(TWO, (0x2000, 1), False, id="two, one refused"),
        pytest.param(TEXT, None, False, id="a text", marks=pytest.mark.ci),
        pytest.param(ONE, None, True, id="one, stored"),
    ],
)
@pytest.mark.parametrize("draws", [pytest.param(5, marks=pytest.mark.slow), pytest.param(1, marks=pytest.mark.part)])
def test_answers_that_come_late_are_never_taken_for_those_of_later_requests(draws, parameter_set, refuses, store, tmp_path):
    """120 seeds in a row a draw: the first draw is from 0 on, the others from anywhere."""
    kinds = []

    @settings(max_examples=draws, phases=(Phase.reuse, Phase.generate))  # a smaller seed is no simpler one
    @given(st.integers(0, 2**32 - 1))
    def are_true(first):
        for seed in range(first, first + 120):
            folder = tmp_path / str(len(kinds))
            kinds.append(truth(seed, parameter_set, folder, lost=(0.0, 0.05)[seed % 2], refuses=refuses, store=store))

    are_true()
    assert ("done" if refuses is None else "rolled back") in kinds
