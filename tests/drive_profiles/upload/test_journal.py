"""What a journal says is true, wherever the tool that wrote it was killed."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drive_profiles.errors import DriveProfileError, FileError
from drive_profiles.upload import journal as module
from drive_profiles.upload.journal import Journal, UploadSnapshot, journal_path, read

A, B, C = (0x2100, 1), (0x2101, 1), (0x6072, 0)
SNAPSHOT = UploadSnapshot(
    node=2,
    bus="socketcan:can0",
    identity={"device_type": 0x20192, "vendor_id": 0x48494C01, "product_code": 0x402, "revision": None, "serial_number": 7},
    profile="emulated_drive",
    old={A: b"\1", B: b"\2\0", C: b""},
    new={A: b"\x11", B: b"\x12\0", C: b"\x13"},
    names={A: "position_gain_per_s", B: 'odd "name"\n ä', C: ""},
)
HEAD = {
    "format": 1,
    "node": 2,
    "bus": "b",
    "identity": {},
    "profile": "p",
    "objects": [{"object": "2100:1", "name": "n", "old": "01", "new": "02"}],
}


@pytest.fixture
def path(tmp_path):
    """Where a journal goes."""
    return tmp_path / "journals" / "node2.jsonl"


def text(*lines):
    return b"".join(json.dumps(line).encode() + b"\n" for line in lines)


class Drive:
    """A drive that may fall silent: the truth, line by line.

    Attributes:
        held: What it holds.
        lines: How many lines of the journal were there at each change of the truth, with the truth.
    """

    def __init__(self, journal, snapshot):
        self.journal = journal
        self.held = dict(snapshot.old)
        self.stored = "no"
        self.truths = [self._truth()]  # one for each line: all that was true while the journal ended there

    def _truth(self):
        return [(dict(self.held), self.stored)]

    def note(self, event, place=None, **more):
        self.journal.note(event, place, **more)
        self.truths.append(self._truth())

    def do(self, change):
        """Something happens to the drive while nobody writes a line."""
        change()
        self.truths[-1] += self._truth()

    def write(self, place, data, happens):
        """As `Upload._put`: announce, send, confirm; the drive may take it, or refuse it, or not answer."""
        self.note("write", place, data=data.hex())
        if happens not in {"refused", "lost on the way"}:
            self.do(lambda: self.held.__setitem__(place, data))
        if happens == "taken":
            self.note("written", place, data=data.hex())

    def look(self, place, answers):
        """As `Upload._read_all`."""
        if answers:
            self.note("read", place, data=self.held[place].hex())
        else:
            self.note("lost", place)

    def store(self, happens):
        """As `Upload.store`."""
        self.note("storing")
        if happens in {"taken", "not answered"}:
            self.do(lambda: setattr(self, "stored", "yes"))
        if happens == "taken":
            self.note("stored")
        elif happens == "refused":
            self.note("not stored")


def check(statement, truth):
    """What the statement says for certain is so; what it says is possible includes what is so."""
    for held, stored in truth:
        for place, data in held.items():
            possible = statement.possible[place]
            assert not possible or data in possible
            assert (place in statement.uncertain) == (len(possible) != 1)
        assert statement.stored in {stored, "unknown"}


happenings = st.sampled_from(["taken", "refused", "not answered", "lost on the way"])
acts = st.lists(
    st.one_of(
        st.tuples(st.just("write"), st.sampled_from([A, B, C]), st.binary(max_size=2), happenings),
        st.tuples(st.just("look"), st.sampled_from([A, B, C]), st.booleans()),
        st.tuples(st.just("store"), happenings),
    ),
    max_size=6,
)


@pytest.mark.slow
@given(acts)
@settings(max_examples=30)
def test_what_a_journal_says_is_true_wherever_it_ends(tmp_path_factory, drawn):
    path = tmp_path_factory.mktemp("journal") / "node2.jsonl"
    with Journal(path, SNAPSHOT) as journal:
        drive = Drive(journal, SNAPSHOT)
        for name, *arguments in drawn:
            getattr(drive, name)(*arguments)
    data = path.read_bytes()
    head = data.index(b"\n") + 1
    for end in range(head, len(data) + 1):
        path.write_bytes(data[:end])
        whole = data.count(b"\n", 0, end)
        check(read(path), drive.truths[whole - 1])


@pytest.mark.ci
def test_a_journal_that_ends_in_its_first_line_is_none(path):
    Journal(path, SNAPSHOT).close()
    data = path.read_bytes()
    for end in range(len(data)):
        path.write_bytes(data[:end])
        with pytest.raises(FileError, match=r"node2\.jsonl"):
            read(path)


def test_the_snapshot_comes_back_whole(path):
    Journal(path, SNAPSHOT).close()
    statement = read(path)
    assert statement.snapshot == SNAPSHOT
    assert statement.possible == {place: frozenset({old}) for place, old in SNAPSHOT.old.items()}
    assert (statement.uncertain, statement.stored, statement.outcome) == ([], "no", "")


def test_nothing_is_sent_before_the_snapshot_is_on_disk(path, monkeypatch):
    synced = []
    monkeypatch.setattr(module, "write_atomically", lambda where, data: (synced.append(data), where.write_bytes(data)))
    path.parent.mkdir()
    Journal(path, SNAPSHOT).close()
    assert synced == [path.read_bytes()]


def test_a_line_is_in_the_file_as_soon_as_it_is_noted(path):
    with Journal(path, SNAPSHOT) as journal:
        journal.note("write", A, data="11")
        assert read(path).possible[A] == {b"\1", b"\x11"}
        assert read(path).uncertain == [A]
        journal.note("written", A, data="11")
        assert read(path).possible[A] == {b"\x11"}
        assert read(path).uncertain == []


def test_an_old_journal_is_never_written_over(path):
    Journal(path, SNAPSHOT).close()
    data = path.read_bytes()
    with pytest.raises(DriveProfileError, match="already exists"):
        Journal(path, SNAPSHOT)
    assert path.read_bytes() == data


def test_a_place_that_cannot_be_written_is_said_before_anything_is_sent(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="cannot be written"):
        Journal(tmp_path / "file" / "journal.jsonl", SNAPSHOT)


def test_the_end_of_a_journal_may_come_twice(path):
    with Journal(path, SNAPSHOT) as journal:
        journal.note("outcome", outcome="done", unknown=[], reason="")
        journal.close()
    journal.close()
    assert read(path).outcome == "done"


def test_of_an_object_that_could_not_be_read_a_write_that_was_not_answered_makes_nothing_certain(path):
    with Journal(path, SNAPSHOT) as journal:
        journal.note("lost", A)
        assert read(path).uncertain == [A]
        journal.note("write", A, data="11")
        assert read(path).uncertain == [A]
        journal.note("read", A, data="77")
        assert read(path).possible[A] == {b"\x77"}


def test_an_object_that_is_not_in_the_snapshot_is_uncertain_until_it_is_read(path):
    with Journal(path, SNAPSHOT) as journal:
        for event, more in (("lost", {}), ("write", {"data": "01"})):
            journal.note(event, (0x3000, 0), **more)
            assert read(path).uncertain == [(0x3000, 0)]
        journal.note("written", (0x3000, 0), data="01")
        assert read(path).uncertain == []


def test_whether_it_was_stored_is_not_known_between_question_and_answer(path):
    with Journal(path, SNAPSHOT) as journal:
        for event, answer in (("storing", "unknown"), ("not stored", "no"), ("storing", "unknown"), ("stored", "yes")):
            journal.note(event)
            assert read(path).stored == answer


def test_a_store_command_that_is_refused_takes_nothing_back_that_was_stored_before(path):
    with Journal(path, SNAPSHOT) as journal:
        for event, answer in (("storing", "unknown"), ("stored", "yes"), ("storing", "unknown"), ("not stored", "yes")):
            journal.note(event)
            assert read(path).stored == answer
        journal.note("storing")  # not answered
        for event in ("storing", "not stored"):
            journal.note(event)
            assert read(path).stored == "unknown"


def test_a_statement_is_said_in_words(path):
    with Journal(path, SNAPSHOT) as journal:
        assert str(read(path)) == (
            "upload to node 2 was not ended; 0 of 3 objects hold the requested values, uncertain: none; not stored"
        )
        journal.note("write", A, data="11")
        journal.note("written", A, data="11")
        journal.note("write", B, data="1200")
        journal.note("lost", C)
        journal.note("storing")
        assert str(read(path)) == (
            "upload to node 2 was not ended; 1 of 3 objects hold the requested values, uncertain: 2101:1, 6072:0; perhaps stored"
        )
        journal.note("outcome", outcome="unknown", unknown=["2101:1"], reason="no answer")
        assert "ended: unknown" in str(read(path))


def test_events_that_a_later_version_adds_are_passed_over(path):
    with Journal(path, SNAPSHOT) as journal:
        journal.note("rolling back", reason='odd\n"reason"')
        journal.note("coffee", A)
    assert read(path).possible == {place: frozenset({old}) for place, old in SNAPSHOT.old.items()}


# Hostile files


@pytest.mark.parametrize(
    "change",
    [
        {"format": 2}, {"format": "1"}, {"node": "x"}, {"node": None}, {"node": float("inf")}, {"node": []}, {"objects": None},
        {"objects": 5}, {"objects": [5]}, {"objects": [{}]}, {"objects": {"a": 1}}, {"identity": 5}, {"identity": None},
        {"identity": {"vendor_id": "x"}}, {"identity": {"vendor_id": 1.5}}, {"identity": {"vendor_id": True}},
        {"identity": {"vendor_id": []}}, {"bus": "\ud800"}, {"profile": "\udfff"},
        *(
            {"objects": [{**HEAD["objects"][0], **odd}]}
            for odd in (
                {"object": 5}, {"object": None}, {"object": ""}, {"object": "xyz"}, {"object": ":"}, {"object": "2100:1:1"},
                {"old": 5}, {"old": None}, {"old": "0"}, {"old": "zz"}, {"new": []}, {"name": "\ud800"},
            )
        ),
    ],
)  # fmt: skip
def test_a_first_line_that_is_no_snapshot_is_refused(tmp_path, change):
    path = tmp_path / "journal"
    path.write_bytes(text(HEAD))
    read(path)
    path.write_bytes(text({**HEAD, **change}))
    with pytest.raises(FileError, match=r"journal:1: is not a line of a journal .*; expected a journal of an upload"):
        read(path)


@pytest.mark.parametrize(
    "line",
    [
        b"", b" ", b"{", b"null", b"5", b"[]", b'"event"', b"{}", b'{"event":"write"}', b'{"event":"write","object":"2100:1"}',
        b'{"event":"write","object":"2100:1","data":5}', b'{"event":"write","object":"2100:1","data":"0"}',
        b'{"event":"write","object":5,"data":"00"}', b'{"event":"lost"}', b'{"event":"lost","object":"x"}', b'{"event":[]}',
        b'{"event":{}}', b'{"event":"outcome"}', b"\xff", b"[" * 100_000, b'{"event":' + b"9" * 5000 + b"}", b"\0",
    ],
)  # fmt: skip
def test_a_line_that_is_none_is_refused_with_its_number(tmp_path, line):
    path = tmp_path / "journal"
    path.write_bytes(text(HEAD, {"event": "storing"}) + line + b"\n")
    with pytest.raises(FileError, match=r"journal:3: is not a line of a journal"):
        read(path)


json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(st.characters(), max_size=6)
    | st.sampled_from(["01", "2100:1"]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)
keys = st.sampled_from(["format", "node", "bus", "identity", "profile", "objects"])
events = st.sampled_from(["write", "written", "read", "lost", "storing", "stored", "not stored", "outcome", "x"])


@given(
    st.one_of(
        st.binary(max_size=60),
        st.builds(lambda key, value: text({**HEAD, key: value}), keys, json_values),
        st.builds(lambda value: text(HEAD, value), json_values),
        st.builds(
            lambda event, place, data: text(HEAD, {"event": event, "object": place, "data": data, "outcome": data}),
            events,
            json_values,
            json_values,
        ),
    )
)
def test_no_file_makes_the_reading_raise_anything_but_an_error_of_the_file(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("hostile") / "journal"
    path.write_bytes(data)
    try:
        statement = read(path)
    except FileError:
        return
    assert str(statement)


def test_what_is_too_large_or_not_there_is_refused(tmp_path, monkeypatch):
    with pytest.raises(FileError, match="cannot be read"):
        read(tmp_path / "none")
    with pytest.raises(FileError, match="cannot be read"):
        read(tmp_path)
    monkeypatch.setattr(module, "MAX_BYTES", 100)
    (tmp_path / "large").write_bytes(b" " * 101)
    with pytest.raises(FileError, match="is larger than 100 bytes"):
        read(tmp_path / "large")


def test_a_journal_that_could_not_be_read_again_is_not_begun(path, monkeypatch):
    """The longest first line, with each object written and put back, is read; one byte more, and nothing is sent."""
    with Journal(path, SNAPSHOT):
        first = len(path.read_bytes())
    monkeypatch.setattr(module, "MAX_SNAPSHOT_BYTES", first - 1)
    with pytest.raises(FileError, match=f"its first line would have {first} bytes; expected at most .*--classes"):
        Journal(path.with_name("other"), SNAPSHOT)
    assert not path.with_name("other").exists()


@pytest.mark.parametrize("length", [1, 4, 65536])
def test_the_notes_of_an_object_are_within_the_journal_s_bound(path, length):
    old, new = bytes(length), bytes([1]) * length
    one = UploadSnapshot(2, "b", {}, "p", {A: old}, {A: new})
    with Journal(path, one) as journal:
        first = path.stat().st_size
        for data in (new, old):
            journal.note("write", A, data=data.hex())
            journal.note("written", A, data=data.hex())
            journal.note("read", A, data=data.hex())
    own = first - len(module._line({**HEAD, "objects": []}))
    assert path.stat().st_size - first <= (module.MAX_BYTES / module.MAX_SNAPSHOT_BYTES - 1) * own


@pytest.mark.parametrize(
    "later_ns",
    [1, 1_500_000, 10**9, 0, -1, -(10**9), -86_400 * 10**9],
    ids=["next", "over a second's end", "a second", "same instant", "set back 1 ns", "set back 1 s", "set back a day"],
)
def test_the_newest_journal_is_the_last_that_was_made_whatever_the_clock_does(tmp_path, later_ns):
    now_ns = 1_795_651_623_999_000_000
    first = journal_path(tmp_path, 2, now_ns)
    assert first.name == "node2-20261126T000703-999000000.jsonl"
    first.touch()
    for foreign in ("node2-copy", "copy", "node2-20269999T000703-000000001", f"node2-20261126T000703-{9**40}"):
        (tmp_path / f"{foreign}.jsonl").touch()
    second = journal_path(tmp_path, 3, now_ns + later_ns)
    assert second.name.partition("-")[2] > first.name.partition("-")[2]
    assert later_ns <= 0 or second.name == journal_path(tmp_path / "empty", 3, now_ns + later_ns).name
