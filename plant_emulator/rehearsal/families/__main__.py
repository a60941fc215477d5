"""Writes the package's table of runs with each drive family."""

import sys

from drive_profiles.family.runs import FILE, FamilyRuns
from drive_profiles.files import toml as files
from plant_emulator.rehearsal.families.made import as_toml, family_run, vendor_families

if __name__ == "__main__":
    wanted = sys.argv[1:] or vendor_families()
    made = files.load(FILE, FamilyRuns).family if FILE.exists() else {}
    for name in wanted:
        made[name] = family_run(name)
        FILE.write_text(as_toml(made), encoding="utf-8")
        sys.stderr.write(f"{name}: {made[name]}\n")
