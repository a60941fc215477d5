"""The model file: what goes in comes out, and a bench takes it in the place of what it believed."""

import math
from pathlib import Path

import numpy as np
import pytest

from drive_profiles.errors import FileError
from drive_profiles.files.toml import loads
from hil.bench.bench import load_bench
from hil.bench.model import (
    Correlation,
    Identified,
    IdentifiedError,
    IdentifiedMode,
    IdentifiedPlant,
    PlantTable,
    load_identified,
    update_file,
    values_in_words,
    with_identified,
)
from hil.design.estimate import Estimate
from hil.errors import NotPossibleError
from hil.robot_tables import TransmissionErrorTable

PLANT = IdentifiedPlant(
    values=PlantTable(
        motor_inertia_kg_m2=2.6e-4,
        motor_damping_nm_s_rad=0.0,
        arm_inertia_kg_m2=8.1,
        arm_damping_nm_s_rad=6.0,
        gear_stiffness_nm_rad=48000.0,
        gear_damping_nm_s_rad=40.0,
    ),
    standard_error={"gear_stiffness_nm_rad": 300.0, "antiresonance_hz": 0.02},
    antiresonance_hz=12.3,
    resonance_hz=22.0,
    damping=0.04,
    cannot_tell=("the motor's viscous damping: Coulomb friction hides it",),
    note='warm, 7 kg, "tool B"\n',
)
ERROR = IdentifiedError(values=TransmissionErrorTable(a2_arcsec=4.9, phi2_deg=221.0, a4_arcsec=2.9, phi4_deg=125.0))


def test_what_is_saved_is_read_again(tmp_path: Path) -> None:
    model = Identified(robot="reference").with_part(3, ERROR).with_part(2, PLANT).with_part(2, ERROR)
    path = tmp_path / "model.toml"
    model.save(path)
    assert load_identified(path) == model
    assert loads(model.dumps(), Identified) == model
    assert list(model.axis) == [2, 3]


@pytest.mark.parametrize("correlations", [(-0.25,), (0.123456789123, -0.5, 0.25)])
def test_the_covariance_of_errors_is_read_again(tmp_path: Path, correlations: tuple[float, ...]) -> None:
    names = ("a2_arcsec", "phi2_deg", "a4_arcsec")[: 2 if len(correlations) == 1 else 3]
    matrix = np.eye(len(names))
    matrix[np.tril_indices(len(names), -1)] = correlations
    matrix = np.maximum(matrix, matrix.T) + np.minimum(matrix, matrix.T) - np.eye(len(names))
    errors = np.array([0.02, 0.1, 0.05])[: len(names)]
    found = Estimate(names, np.zeros(len(names)), matrix * np.outer(errors, errors))
    part = ERROR.model_copy(
        update={"standard_error": dict(zip(names, errors.tolist(), strict=True)), "correlation": Correlation.of(found)}
    )
    update_file(tmp_path / "model.toml", "reference", 2, part)
    read = load_identified(tmp_path / "model.toml").axis[2].ate
    assert read is not None
    assert read == part
    assert read.correlations(names) == pytest.approx(matrix, abs=1e-8)
    others = read.correlations(["phi4_deg", "phi2_deg", "a2_arcsec"])
    assert others[1, 2] == pytest.approx(correlations[0], abs=1e-8)
    assert not others[0, 1:].any(), "of that nothing is known"


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('names = ["a2_arcsec", "phi4_deg"]\nbelow = [[0.5]]', "phi4_deg has no standard error"),
        ('names = ["a2_arcsec", "phi2_deg"]\nbelow = [[1.1]]', "eigenvalue is -0.1; expected none below 0"),
        ('names = ["a2_arcsec", "phi2_deg"]\nbelow = [[nan]]', "finite"),
        ('names = ["a2_arcsec", "phi2_deg"]\nbelow = [[0.1, 0.2]]', r"rows of \[2\] numbers; expected \[1\] for 2 names"),
        ('names = ["a2_arcsec", "a2_arcsec"]\nbelow = [[0.1]]', "a number is there twice"),
    ],
)
def test_a_correlation_that_none_can_be_is_refused(table: str, message: str) -> None:
    errors = {"a2_arcsec": 0.02, "phi2_deg": 0.1}
    text = Identified(robot="reference").with_part(2, ERROR.model_copy(update={"standard_error": errors})).dumps()
    with pytest.raises(FileError, match=message):
        loads(f"{text}\n[axis.2.ate.correlation]\n{table}\n", Identified)


def test_where_it_was_identified_is_kept(tmp_path: Path) -> None:
    emulated = PLANT.model_copy(update={"emulated": True})
    model = Identified(robot="reference").with_part(2, emulated).with_part(2, ERROR)
    model.save(tmp_path / "model.toml")
    read = load_identified(tmp_path / "model.toml").axis[2]
    assert read.plant is not None
    assert read.ate is not None
    assert (read.plant.emulated, read.ate.emulated) == (True, None)


def test_a_part_that_is_identified_anew_replaces_only_itself(tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    update_file(path, "reference", 2, PLANT)
    update_file(path, "reference", 2, ERROR)
    again = update_file(path, "reference", 2, ERROR.model_copy(update={"learnt_by": "adaptive"}))
    assert again.axis[2].plant == PLANT
    assert again.axis[2].ate is not None
    assert again.axis[2].ate.learnt_by == "adaptive"


@pytest.mark.parametrize("source", ["identify", "sensorless", "recording", "adaptive", "probing"])
def test_every_source_of_an_error_is_read_again(tmp_path: Path, source: str) -> None:
    part = ERROR.model_validate(ERROR.model_dump() | {"learnt_by": source})
    update_file(tmp_path / "model.toml", "reference", 2, part)
    assert load_identified(tmp_path / "model.toml").axis[2].ate == part


def test_a_source_that_nobody_knows_is_refused_with_those_that_there_are(tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    update_file(path, "reference", 2, ERROR)
    path.write_text(path.read_text().replace('"identify"', '"sensor-less"'))
    with pytest.raises(FileError, match="sensorless"):
        load_identified(path)


def test_another_robots_file_is_not_written_to(tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    update_file(path, "reference", 2, PLANT)
    before = path.read_bytes()
    with pytest.raises(NotPossibleError, match="of robot 'reference'; expected 'other'"):
        update_file(path, "other", 2, ERROR)
    assert path.read_bytes() == before


def test_a_wrong_key_is_named_with_its_line() -> None:
    text = Identified(robot="reference").with_part(2, ERROR).dumps().replace("a2_arcsec", "a2_arcmin")
    with pytest.raises(FileError, match="a2_arcmin"):
        loads(text, Identified)


def test_the_bench_takes_what_was_identified_and_keeps_the_rest() -> None:
    bench = load_bench("reference")
    taken = with_identified(bench, Identified(robot="reference").with_part(2, PLANT).with_part(3, ERROR))
    two, three, five = taken.axis[2].model, taken.axis[3].model, taken.axis[5]
    assert two is not None
    assert three is not None
    assert two.gear_stiffness_nm_rad == 48000.0
    assert two.ate == bench.axis[2].model.ate  # type: ignore[union-attr]
    assert three.ate == ERROR.values
    assert three.gear_stiffness_nm_rad == bench.axis[3].model.gear_stiffness_nm_rad  # type: ignore[union-attr]
    assert five == bench.axis[5]
    assert taken.axis[2].control == bench.axis[2].control


def test_of_an_arm_that_rings_with_several_modes_the_bench_takes_the_gears_stiffness_and_not_that_of_one_mode() -> None:
    modes = tuple(
        IdentifiedMode(antiresonance_hz=hz, resonance_hz=hz + 1.0, damping=0.02, inertia_kg_m2=inertia)
        for hz, inertia in ((10.0, 6.0), (15.0, 2.0))
    )
    bench = load_bench("reference")
    several = with_identified(bench, Identified(robot="reference").with_part(2, PLANT.model_copy(update={"modes": modes})))
    expected = (2.0 * math.pi) ** 2 * (6.0 * 100.0 + 2.0 * 225.0)
    assert several.axis[2].gear_stiffness_nm_rad == pytest.approx(expected)
    assert several.axis[2].model is not None
    assert several.axis[2].model.gear_stiffness_nm_rad == 48000.0
    single = with_identified(bench, Identified(robot="reference").with_part(2, PLANT))
    assert single.axis[2].gear_stiffness_nm_rad is None


def test_an_axis_without_any_model_gets_one() -> None:
    bench = load_bench("reference")
    bare = bench.axis[2].model_copy(update={"model": None})
    bench = bench.model_copy(update={"axis": {**bench.axis, 2: bare}})
    assert with_identified(bench, Identified(robot="reference").with_part(2, ERROR)).axis[2].model is None
    model = with_identified(bench, Identified(robot="reference").with_part(2, PLANT)).axis[2].model
    assert model is not None
    assert model.ate.a2_arcsec == 0.0


def test_a_model_file_holds_any_order_with_its_errors(tmp_path):
    values = TransmissionErrorTable.of({0.5: 4.0, 1: 20.0, 3: 2.0}, {0.5: 10.0, 1: 33.0, 3: 70.0})
    errors = {"a0.5_arcsec": 0.2, "phi0.5_deg": 3.0, "a1_arcsec": 0.1, "a3_arcsec": 0.1}
    update_file(tmp_path / "model.toml", "reference", 2, IdentifiedError(values=values, standard_error=errors))
    found = load_identified(tmp_path / "model.toml").axis[2].ate
    assert (found.values, found.standard_error) == (values, errors)
    assert values_in_words(found)[:2] == ["A_0.5 = 4.00 ± 0.20 arcsec", "φ_0.5 = 10.00 ± 3.00°"]
