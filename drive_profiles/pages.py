"""The pages of ``docs/drives``, made from the profiles alone."""

from collections.abc import Callable, Iterable, Iterator, Sequence

from drive_profiles.errors import NotRealisableError
from drive_profiles.family.capability import LoopFacts, NotchFacts
from drive_profiles.family.parameter import Fact
from drive_profiles.family.product import Product
from drive_profiles.family.profile import Profile
from drive_profiles.family.runs import FamilyRun, family_runs
from drive_profiles.realisation import realise
from drive_profiles.realisation.biquad import NotchTarget
from drive_profiles.standard import shown

SIGN = "⚠"
"""Sign that marks unverified facts."""

ASSUMED_PERIOD_S = 125e-6
"""Filter period of the example where the drive's is not known: drives run their velocity loops at 62.5 to 250 us."""

HEXADECIMAL = frozenset({
    "vendor_id", "product_code", "revision", "min_revision", "max_revision", "device_type", "signature", "restore_signature",
    "code",
})  # fmt: skip
_OWN_TABLE = frozenset({"gains", "sections", "source", "evidence", "note"})
_LABELS = {"zero": "must be 0", "a_sign": "sign of a·y"}
"""Fields whose own name says too little."""
_ONLY_WITH = {"rated_torque_step_nm": "rated_torque", "signature": "object", "wait_s": "object", "restore_signature": "restore"}
"""Fields that say something only of an object that the drive has, with the field of that object."""
_UNITS = {"_s": "s", "_a": "A", "_hz": "Hz", "_nm": "N·m"}
_COMMAND = "drive-profiles pages --out docs/drives"
QUESTIONS = {
    "p_pi_inside": "position P, velocity PI inside the drive",
    "notch_inside": "the notch inside the drive",
    "notch_variable_while_moving": "the notch follows the speed during a motion",
    "host_closed": "the host closes the loop by torque",
    "reference_correction": "the host corrects the reference",
    "torque_offset": "the host adds a torque",
}
_COLUMNS = ("name", "object", "type", "unit", "step", "limits", "effective", "PDO", "evidence", "meaning")
_CLASSES = {"tuning": "Tuning", "limits": "Limits", "communication": "Communication", "commissioning": "Commissioning"}


def page(profile: Profile) -> str:
    """Return the page of one family."""
    sources = _Sources(profile)
    parts = [
        f"# {profile.title}",
        f"With this page you can look up what this {profile.kind} can do, and every parameter with its source.\n"
        f"It describes the profile `{profile.name}`.\n"
        f"`{_COMMAND}` makes it from `drive_profiles/vendors/{profile.name}.toml`.",
        f"{SIGN} marks a fact that no available document, file or measurement confirms: check it on the {profile.kind} or in "
        "its manual.\nAn upload needs `--allow-unverified` to write such a value.\nA number in brackets is a source in the list "
        "at the end; *no source* means that none of them states the fact.",
        *_capabilities(profile),
        *_notch_held(profile),
    ]
    for title, fact in facts(profile):
        parts += [f"## {title}", *_fact(fact, sources)]
    if profile.aborts:
        rows = [(f"0x{a.code:08X}", a.text, sources.evidence(a)) for a in profile.aborts]
        parts += ["## Abort codes of this drive", _table(("code", "meaning", "evidence"), rows)]
    if profile.fault_codes:
        rows = [(f"{each.code:04X}h", each.text, sources.evidence(each)) for each in profile.fault_codes]
        parts += ["## Error codes of this drive", _table(("code", "meaning", "evidence"), rows)]
    if profile.quirks:
        parts += ["## Notes", "\n".join(f"- {quirk}" for quirk in profile.quirks)]
    parts += _products(profile, sources)
    parts += ["## Parameters", *_parameters(profile, sources)]
    parts += ["## Sources", "\n".join(f"{n}. {source}" for n, source in enumerate(sources.all, 1))]
    return "\n\n".join(parts) + "\n"


def index(profiles: Sequence[Profile]) -> str:
    """Return the page that lists all families with their deciding facts."""

    def answers(profile: Profile) -> tuple[str, ...]:
        c = profile.capabilities
        if c is None:
            return ("", "", "", "")
        return c.p_pi_inside.answer, c.notch_inside.answer, c.notch_variable_while_moving.answer, c.host_closed.answer

    rows = [
        (f"[{p.title}]({p.name}.md)", f"`{p.name}`", p.kind, *answers(p), str(len(p.parameters)), str(_unverified(p)))
        for p in sorted(profiles, key=lambda p: p.name)
    ]
    header = (
        "family", "profile", "kind", "P-PI inside", "notch inside", "notch follows the speed", "host-closed", "parameters",
        "unverified",
    )  # fmt: skip
    return "\n\n".join([
        "# Drives",
        "With this page you can compare the drive families, and find the page with the facts on each.\n"
        f"`{_COMMAND}` makes these pages from `drive_profiles/vendors`.",
        "\n".join((
            "- `exact`: the paper's own law or filter.",
            "- `yes`: supported.",
            "- `approximate`: supported, with a difference that the family's page states.",
            "- `lost`: the drive keeps less than half of the notch's depth, in dB.",
            "- `no`: not supported.",
            "- `unknown`: no available document or file answers the question.",
        )),
        "The page of each family gives the reasons.",
        _table(header, rows),
        *_further_products(profiles, answers),
        *_runs(profiles),
    ]) + "\n"  # fmt: skip


_RUN_COLUMNS = ("mode", "moved", "plant identified", "error identified", "notch in the drive", "tip, mm")


def _runs(profiles: Sequence[Profile]) -> Iterator[str]:
    """Yield the table of runs with each family's emulated drive."""
    runs = family_runs()
    made = [(profile, runs[profile.name]) for profile in sorted(profiles, key=lambda each: each.name) if profile.name in runs]
    if not made:
        return
    yield "## Runs"
    yield (
        "The table shows what `hil run`, `hil identify plant` and `hil identify ate` do with each family.\n"
        "The results come from emulated drives whose gains are set; they say nothing about real firmware.\n"
        "*Tip* is the tip peak on axis 2 of the reference robot, without → with cancellation by set-points.\n"
        "The last three columns name the limits of the bench file.\n"
        "The master enforces all of them except those *kept by the drive*, for which the drive uses its own value.\n"
        "`python -m plant_emulator.rehearsal.families` makes the table."
    )
    header = ("family", *_RUN_COLUMNS, "held by the drive", "held by the master alone", "kept by the drive")
    yield _table(header, [_run_row(profile, run) for profile, run in made])
    refused = [(profile.name, words) for profile, run in made for words in (run.plant_refusal, run.refusal) if words]
    if refused:
        yield "Refused:"
        yield "\n".join(f"- {name}: {words}." for name, words in refused)


def _run_row(profile: Profile, run: FamilyRun) -> tuple[str, ...]:
    def word(is_done: bool) -> str:
        return "yes" if is_done else "no"

    tip = "" if run.tip_mm is None else f"{run.tip_mm:.4f}"
    tip += "" if run.cancelled_tip_mm is None else f"\u00a0→\u00a0{run.cancelled_tip_mm:.4f}"  # on one line
    notch = "" if profile.capabilities is None else profile.capabilities.notch_inside.answer
    limits = (", ".join(f"`{key}`" for key in keys) for keys in (run.held_by_drive, run.held_by_master, run.kept_by_drive))
    return (
        profile.title, run.mode, word(run.is_moved), word(run.is_moved and not run.plant_refusal), word(run.is_identified), notch,
        tip, *limits,
    )  # fmt: skip


def _further_products(profiles: Sequence[Profile], answers: Callable[[Profile], tuple[str, ...]]) -> Iterator[str]:
    """Yield the table of the products beside each family's first one."""
    rows = [
        (f"[{member.title}]({profile.name}.md#products)", f"`{member.label}`", *answers(member), str(len(member.parameters)))
        for profile in sorted(profiles, key=lambda p: p.name)
        for member in profile.members[1:]
    ]
    if rows:
        yield "The table describes the first product of each family. Further products:"
        yield _table(
            ("product", "profile", "P-PI inside", "notch inside", "follows the speed", "host-closed", "parameters"), rows
        )


def written(profiles: Sequence[Profile]) -> dict[str, str]:
    """Return all pages by file name."""
    return {"README.md": index(profiles)} | {f"{profile.name}.md": page(profile) for profile in profiles}


class _Sources:
    """Sources of a profile, each once, in the order of the file."""

    def __init__(self, profile: Profile) -> None:
        members = profile.members
        sources = [fact.source for _, fact in facts(profile)] + [each.source for each in (*profile.aborts, *profile.fault_codes)]
        sources += [fact.source for member in members for _, fact in facts(member)]
        sources += [entry.source for member in members for entry in member.parameters.values()]
        self.all = list(dict.fromkeys(sources))

    def evidence(self, fact: Fact) -> str:
        """Return the evidence of a fact, and the number of its source."""
        sign = "" if fact.is_verified else f"{SIGN} "
        return f"{sign}{fact.evidence} [{self.all.index(fact.source) + 1}]"


def facts(profile: Profile) -> Iterator[tuple[str, Fact]]:
    """Yield the tables of facts that a profile has, each with its title."""
    named = (
        ("Identity", profile.identity),
        ("Modes", profile.modes),
        ("Position mode of its maker", profile.position_mode),
        ("SYNC", profile.sync),
        ("Loop", profile.loop),
        ("Filter", profile.notch),
        ("Torque", profile.torque),
        ("Encoder", profile.encoder),
        ("Second encoder", profile.load_encoder),
        ("Store", profile.store),
    )
    return ((title, fact) for title, fact in named if fact is not None)


def _unverified(profile: Profile) -> int:
    stated: list[Fact] = [
        *(fact for _, fact in facts(profile)),
        *profile.aborts,
        *profile.fault_codes,
        *profile.parameters.values(),
    ]
    for product in profile.products:
        stated += [product, *product.facts.values()]
        stated += [product.parameters[name].of(profile.parameters.get(name), product) for name in product.parameters]
    return sum(not fact.is_verified for fact in stated)


def _capabilities(profile: Profile) -> Iterator[str]:
    if profile.capabilities is None:
        return
    yield "## Control loop"
    rows = [(QUESTIONS[name], f"**{entry.answer}**", entry.reason) for name, entry in profile.capabilities]
    yield _table(("what", "answer", "why"), rows)


def _notch_held(profile: Profile) -> Iterator[str]:
    """Yield the paper's notch (Table 3) as the drive holds it."""
    if profile.notch is None:
        return
    yield "### The paper's notch (Table 3) in this drive"
    is_known = any(fact is not None and fact.period_s is not None for fact in (profile.notch, profile.loop))
    assumed_s = None if is_known else ASSUMED_PERIOD_S
    if assumed_s:
        yield f"The period of the drive's filter is not known; the table assumes {1e6 * assumed_s:g} µs."
    rows = []
    for axis, speed_rps, offset_hz, zeta_rn in (("2", 5.92, 0.5, 0.028), ("3", 5.72, 0.7, 0.036)):
        target = NotchTarget.at_speed(2, speed_rps, offset_hz, zeta_rn, 0.1)
        rows.append((axis, f"{target.zero_hz:.2f} Hz", f"{target.pole_hz:.2f} Hz", *_held(profile, target, assumed_s)))
    yield _table(("axis", "zeros requested", "poles requested", "zeros held", "poles held", "depth lost", "verdict"), rows)


def _held(profile: Profile, target: NotchTarget, period_s: float | None) -> tuple[str, ...]:
    try:
        realisation = realise(profile, target, period_s=period_s, allow_approximate=True)
    except NotRealisableError as error:
        return "", "", "", "refused: " + "; ".join(error.reasons)
    held = realisation.held
    verdict = ": ".join(filter(None, (realisation.verdict, "; ".join(realisation.reasons))))
    zeros, poles = f"{held.zero_hz:.2f} Hz, ζ {held.zeta_zero:.3f}", f"{held.pole_hz:.2f} Hz, ζ {held.zeta_pole:.3f}"
    lost = realisation.deviations.depth_db
    return zeros, poles, f"{lost if abs(lost) >= 0.05 else 0.0:.1f} dB", verdict


def _fact(fact: Fact, sources: _Sources) -> Iterator[str]:
    """Yield the table of one fact of a profile."""
    if rows := fact_rows(fact):
        yield _table(("fact", "value"), rows)
    if isinstance(fact, LoopFacts) and fact.gains:
        yield _gains(fact)
    if isinstance(fact, NotchFacts):
        for n, section in enumerate(fact.sections, 1):
            parts = [(part.replace("_", " "), f"`{name}`") for part, name in section.parts.items()]
            parts += [("must hold", f"`{name}` = {value:g}") for name, value in section.settings.items()]
            yield f"Section {n}:"
            yield _table(("part", "parameter"), parts)
    note = getattr(fact, "note", "")
    if note:
        yield note
    yield f"Evidence: {sources.evidence(fact)}."


def fact_rows(fact: Fact) -> list[tuple[str, str]]:
    """Return names and values of a fact's fields, without those that are not known."""
    return [
        (_label(name), text)
        for name, value in fact
        if name not in _OWN_TABLE and not _is_silent(fact, name) and (text := _text(name, value))
    ]


def _is_silent(fact: Fact, name: str) -> bool:
    """True if a field has a default that states nothing of this drive.

    It may be of an object that the drive lacks. Of a filter a step or damping of 0 is not a limit, and only coefficients of a
    known scaling have a sign.
    """
    if name in _ONLY_WITH:
        return getattr(fact, _ONLY_WITH[name]) is None
    if not isinstance(fact, NotchFacts):
        return False
    if name == "a_sign":
        return fact.form != "coefficients" or fact.word == "integer, scaling not known"
    if name == "min_zero_damping" and fact.form == "symmetric":  # the fixed depth
        return False
    return name in {"frequency_step_hz", "min_zero_damping", "min_pole_damping"} and getattr(fact, name) == 0.0


def _gains(loop: LoopFacts) -> str:
    rows = []
    for role, gain in loop.gains.items():
        factor = f"{SIGN} not known" if gain.factor is None else f"{gain.factor:g}"
        rows.append((role, f"`{gain.parameter}`", factor + (" · K_t" if gain.times_torque_constant else "")))
    return _table(("gain", "parameter", "SI per unit"), rows)


def _products(profile: Profile, sources: _Sources) -> Iterator[str]:
    """Yield a family's products, and how each differs from the first."""
    if not profile.products:
        return
    yield "## Products"
    yield f"The rest of this page describes the first product. To select another, give `{profile.name}/PRODUCT` as the profile."
    rows = []
    for member in profile.members:
        identity = member.identity
        code = f"{SIGN} not known" if identity.product_code is None else _text("product_code", identity.product_code)
        type_ = _text("device_type", identity.device_type)
        rows.append(
            (f"`{identity.product}`", member.title, code, identity.range_in_words or "any", type_, sources.evidence(identity))
        )
    yield _table(("product", "title", "product code", "firmware", "device type", "evidence"), rows)
    first = profile.members[0]
    for product, member in zip(profile.products, profile.members[1:], strict=True):
        yield f"### {member.title}"
        yield from _differences(first, product, member, sources)


def _differences(first: Profile, product: Product, member: Profile, sources: _Sources) -> Iterator[str]:
    """Yield the differences between a product and the family's first one."""
    if product.quirks:
        yield "\n".join(f"- {quirk}" for quirk in product.quirks)
    if product.absent:
        yield f"It does not have {', '.join(f'`{name}`' for name in product.absent)}."
    if product.capabilities:
        answers = [(QUESTIONS[name], f"**{entry.answer}**", entry.reason) for name, entry in product.capabilities.items()]
        yield _table(("what", "answer", "why"), answers)
    for title, fact in facts(member):
        if fact in product.facts.values():
            yield f"**{title}**"
            yield from _fact(fact, sources)
    changed = [_row(name, member, sources) for name in product.parameters]
    if changed:
        yield _table(_COLUMNS, changed)
    defaults = {name: member.parameters[name].default for name in product.parameters}
    held = {name: known.default for name, known in first.parameters.items()}
    others = [f"`{name}` {value}" for name, value in defaults.items() if value is not None and value != held.get(name)]
    if others:
        yield f"Different factory settings, as raw values: {', '.join(others)}."
    if not (product.quirks or product.absent or product.capabilities or product.facts or changed):
        yield "No other difference is known."


def _text(name: str, value: object) -> str:
    """Write a value for people: identifiers hexadecimal, times in ms or µs."""
    if value is None or value in ("", (), {}):
        return ""
    if isinstance(value, dict):
        return ", ".join(f"{key}: {_text(name, each)}" for key, each in value.items())
    if isinstance(value, tuple):
        return ", ".join(_text(name, each) for each in value)
    if name in HEXADECIMAL and isinstance(value, int):
        return f"0x{value:08X}"
    unit = next((unit for suffix, unit in _UNITS.items() if name.endswith(suffix)), "")
    if unit == "s" and isinstance(value, float):
        return f"{value:g} s" if value >= 1.0 else f"{1e3 * value:g} ms" if value >= 1e-3 else f"{1e6 * value:g} µs"
    return f"{value:g} {unit}".rstrip() if isinstance(value, float) else str(value)


def _label(name: str) -> str:
    """Return a field's name without its unit, which the value carries."""
    if name in _LABELS:
        return _LABELS[name]
    suffix = next((suffix for suffix in _UNITS if name.endswith(suffix)), "")
    return name.removesuffix(suffix).replace("_", " ")


def _parameters(profile: Profile, sources: _Sources) -> Iterator[str]:
    for name, title in _CLASSES.items():
        rows = [_row(key, profile, sources) for key, entry in profile.parameters.items() if entry.parameter_class == name]
        if rows:
            yield f"### {title}"
            yield _table(_COLUMNS, rows)


def _row(name: str, profile: Profile, sources: _Sources) -> tuple[str, ...]:
    entry = profile.parameters[name]
    low = "" if entry.minimum is None else f"{entry.minimum:.6g}"
    high = "" if entry.maximum is None else f"{entry.maximum:.6g}"
    limits = f"{low} … {high}".strip() if low or high else ""
    access = "read only" if entry.access == "ro" else entry.effective
    mappable = "yes" if entry.mappable else ""
    unit = shown.unit(profile.unit_of(name))
    return (
        f"`{name}`", entry.written_address, entry.data_type, unit, entry.step, limits, access, mappable,
        sources.evidence(entry), entry.description,
    )  # fmt: skip


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in line) + " |" for line in lines)
