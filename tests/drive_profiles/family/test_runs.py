"""The table of what a run does with each family: whole, and shown where a user looks for it."""

import json
from pathlib import Path

from typer.testing import CliRunner

from drive_profiles import pages
from drive_profiles.cli.main import app
from drive_profiles.family.profile import Profile, available
from drive_profiles.family.runs import family_runs, in_words

VENDORS = {name for name in available() if Profile.load(name).kind == "drive"} - {"emulated_drive"}


def test_every_vendor_family_is_in_the_table_and_is_moved():
    assert set(family_runs()) == VENDORS
    assert all(run.is_moved for run in family_runs().values())


def test_what_is_not_done_has_a_reason():
    for name, run in family_runs().items():
        assert run.is_cancelled or run.refusal, name
    assert sum(run.is_identified and run.is_cancelled for run in family_runs().values()) >= 11


def test_the_list_of_profiles_says_in_which_mode_each_runs():
    shown = CliRunner().invoke(app, ["list"]).stdout
    assert ["kollmorgen_akd", "CSP"] in [line.split()[:2] for line in shown.splitlines()]
    listed = {each["name"]: each["runs"] for each in json.loads(CliRunner().invoke(app, ["list", "--json"]).stdout)}
    assert listed["maxon_epos2"]["mode"] == "position mode (2062h)"
    assert listed["emulated_accelerometer"] is None


def test_a_mode_of_the_makers_own_has_a_short_word():
    assert [in_words(family_runs()[name]) for name in ("maxon_epos2", "schunk_pilz_prbt")] == ["own", "IP"]


def test_the_readme_has_the_table():
    """Two values of the tip mean that a run moved and identified the family, and that cancellation was on for the second."""
    rows = []
    for name, run in sorted(family_runs().items()):
        _, mode, _, plant, _, notch, tip, *_ = pages._run_row(Profile.load(name), run)
        rows.append((f"`{name}`", mode, plant, notch, tip, str(len(run.held_by_master) or "none")))
    header = ("family", "mode", "plant identified", "notch in drive", "tip, mm", "limits held by the master alone")
    page = (Path(__file__).parents[3] / "README.md").read_text(encoding="utf-8")
    assert pages._table(header, rows) in page
