"""Commands of ``drive-profiles`` that show drive families."""

from typing import TYPE_CHECKING

from drive_profiles.cli.application import command
from drive_profiles.cli.console import FILE_EPILOG, exit_on_error, print_json, table
from drive_profiles.cli.options import JsonOption, ProfileName
from drive_profiles.standard.shown import number, unit

if TYPE_CHECKING:
    from drive_profiles.family.parameter import Parameter
    from drive_profiles.family.profile import Profile


@command("list", epilog=FILE_EPILOG)
def list_profiles(*, as_json: JsonOption = False) -> None:
    """List the profiles, and what each drive can do.

    `notch inside` is the paper's notch at one speed; `show` says whether it follows the speed, and gives the reasons.
    `own` stands for a position mode of the drive's maker.

    Examples:
        drive-profiles list

        drive-profiles list --json
    """
    from drive_profiles.family.profile import Profile, available
    from drive_profiles.family.runs import family_runs, in_words
    from drive_profiles.standard.cia402 import Mode

    with exit_on_error():
        profiles = [Profile.load(name) for name in available()]
    if as_json:
        print_json(
            [
                {
                    "name": p.name,
                    "title": p.title,
                    "kind": p.kind,
                    **p.identity.model_dump(),
                    "products": [_product(member) for member in p.members] if p.products else [],
                    "capabilities": None if p.capabilities is None else p.capabilities.model_dump(),
                    "runs": family_runs()[p.name].model_dump() if p.name in family_runs() else None,
                }
                for p in profiles
            ]
        )
        return
    rows: list[tuple[str, ...]] = []
    for p in profiles:
        able = p.capabilities
        if able is None:
            rows.append((p.name, "-", "-", "-", "-"))
            continue
        answers = (able.p_pi_inside, able.notch_inside, able.host_closed)
        mode = in_words(family_runs()[p.name]) if p.name in family_runs() else Mode.CSP.name
        rows.append((p.name, mode, *(each.answer for each in answers)))
    table("", ("name", "runs in", "P-PI inside", "notch inside", "host-closed"), rows)


@command(epilog=FILE_EPILOG)
def show(name: ProfileName, *, as_json: JsonOption = False) -> None:
    """Show one profile with its capabilities and parameters.

    Each capability has its reason, each parameter its object and unit.

    Example: drive-profiles show emulated_drive
    """
    from drive_profiles.family.profile import Profile
    from drive_profiles.pages import QUESTIONS, fact_rows, facts

    with exit_on_error():
        profile = Profile.load(name)
    if as_json:
        print_json(profile.model_dump(by_alias=True))
        return
    rows = [("", "name", profile.label, ""), ("", "title", profile.title, ""), ("", "kind", profile.kind, "")]
    for title, fact in facts(profile):
        note = str(getattr(fact, "note", ""))
        rows += [(title, what, text, fact.evidence) for what, text in (*fact_rows(fact), ("note", note)) if text]
    table("", ("of", "fact", "value", "evidence"), rows)
    if profile.capabilities is not None:
        answers = [(QUESTIONS[name], entry.answer, entry.reason) for name, entry in profile.capabilities]
        table("capabilities", ("what", "answer", "reason"), answers)
    if profile.products:
        members = [_product(member) for member in profile.members]
        title = f"products: drive-profiles show {profile.name}/PRODUCT"
        table(title, tuple(members[0]), [tuple(member.values()) for member in members])
    if profile.quirks:
        table("good to know", ("",), [(text,) for text in profile.quirks])
    table(
        "parameters",
        ("name", "object", "type", "unit", "step on the wire", "access", "class", "acts", "evidence"),
        [
            (
                name,
                entry.written_address,
                entry.data_type,
                unit(profile.unit_of(name)),
                _step(entry),
                entry.access,
                entry.parameter_class,
                {"now": "now", "disabled": "set while disabled", "reset": "after a reset"}[entry.effective],
                entry.evidence,
            )
            for name, entry in profile.parameters.items()
        ],
    )


def _product(member: "Profile") -> dict[str, str]:
    identity = member.identity
    return {
        "product": identity.product,
        "title": member.title,
        "product code": _number_or_unknown(identity.product_code),
        "firmware": identity.range_in_words or "any",
        "device type": _number_or_unknown(identity.device_type),
        "parameters": str(len(member.parameters)),
        "evidence": identity.evidence,
    }


def _step(entry: "Parameter") -> str:
    """Return the value of one step on the wire, if not 1."""
    if isinstance(entry.scale, str):
        return entry.step
    return "" if entry.scale == 1.0 else f"{number(entry.scale)} {unit(entry.unit)}".rstrip()


def _number_or_unknown(value: int | None) -> str:
    return "not known" if value is None else f"0x{value:08X}"
