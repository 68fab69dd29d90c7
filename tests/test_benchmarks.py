"""The benchmarks on a few spheres: they run, and what they compare is the same physics."""

import dataclasses
import json
import math
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import taichi_dem as dem
from benchmarks import bed as beds
from benchmarks import effect_costs, hard_cases, lammps, peers, report, run, survival
from taichi_dem.contacts import elasticity
from taichi_dem.cost import Cost
from tests.hard import edges, invariants
from tests.hard.kit import Case, Setting
from tests.hard.kit import Figure as Held

FEW = 20
QUICK = ("--rounds", "2", "--seconds", "0.02")


@pytest.fixture(scope="module")
def bed():
    return beds.settled(FEW)


@pytest.fixture(scope="module")
def settled(bed):
    simulation = dem.Simulation(beds.scene(bed), dt=beds.TIME_STEP)
    simulation.run(steps=50_000)
    return simulation


@pytest.mark.parametrize(
    "arguments",
    [
        ("settled_bed", "-n", str(FEW), "--peers", "--warm-up", "10", "--patience", "0", *QUICK),
        ("rebuild", "-n", str(FEW), "--rounds", "2", "--steps", "20", "--patience", "0"),
        ("memory", "-n", str(2 * FEW)),
        ("startup", "-n", str(FEW), "--rounds", "1", "--patience", "0"),
        ("substrate_step", "-n", str(FEW), "-g", str(FEW // 4), "--warm-up", "0", *QUICK),
        ("law_costs", "-n", str(FEW), "--laws", "JKR", "EEPA, Mindlin, CDT", *QUICK),
        pytest.param(
            ("effect_costs", "-n", str(FEW), "--scenes", "powder", *QUICK), marks=pytest.mark.slow
        ),
        pytest.param(
            ("absent_effects", "-n", str(FEW), "--effects", "rolling", "--copies", "1", *QUICK),
            marks=pytest.mark.slow,
        ),
        pytest.param(
            ("sleeping_bed", "-n", str(FEW), "--rounds", "2", "--steps", "50"),
            marks=pytest.mark.slow,
        ),
        ("half_space", "--count", "300", "--tolerance", "1e-2"),
        ("cold_solve", "-n", "100"),
        ("moving_contacts", "--side", "3", "--softness", "1", "--periods", "3", "--steps", "20"),
    ],
    ids=lambda arguments: arguments[0],
)
def test_benchmark_runs_and_writes_its_figures(arguments, tmp_path, capsys):
    run.main([*arguments, "-o", str(tmp_path)])
    document = json.loads((tmp_path / f"{arguments[0]}.json").read_text())
    assert document["benchmark"] == arguments[0]
    values = np.array([figure["value"] for figure in document["figures"]])
    assert np.isfinite(values).all()
    assert (values > 0).all()
    printed = capsys.readouterr().out
    assert all(figure["what"] in printed for figure in document["figures"])


def test_a_shaken_bed_comes_to_rest_and_stays_there(capsys):
    missed = run.main(["soak", "-n", str(FEW), "--steps", "150000"])
    assert not missed, capsys.readouterr().out


def test_a_case_that_raises_is_a_row_that_breaks(monkeypatch, capsys):
    def raises(setting):
        yield Held("energy", 0.5, 1.0)
        if setting.driver == "parallel":
            raise ZeroDivisionError("no stiffness\nat all")

    settings = Setting("serial"), Setting("parallel")
    cases = [
        Case("trial", "raises", raises, settings),
        Case("trial", "holds", lambda _: [Held("energy", 0.5, 1.0)], settings),
    ]
    monkeypatch.setattr("tests.hard.CASES", cases)
    assert run.main(["hard_cases"]) == 1
    printed = capsys.readouterr().out
    assert "raises [parallel]: raised: ZeroDivisionError: no stiffness" in printed
    assert "holds [serial]: energy" in printed
    assert [figure.met for figure in hard_cases.figures(cases[0])] == [True, False]


@pytest.mark.parametrize("name", ["hard_cases", "survival"])
def test_words_that_match_no_case_are_refused(name):
    with pytest.raises(SystemExit, match="no case has all of 'impact', 'of nothing'"):
        run.main([name, "impact", "of nothing"])


def test_hard_scenes_survive_here(capsys):
    assert not run.main(["survival", "impact", "restitution", "0.5"])
    assert "ours" in capsys.readouterr().out


TRIAL = SimpleNamespace(sim=SimpleNamespace(scene=edges.pair()), dt=1e-6, steps=10, held=0.0)


@pytest.mark.parametrize(
    ("raised", "sound"),
    [
        (survival.PeerStoppedError("ERROR: lost atoms"), True),
        (survival.PeerCrashedError("exit status -11"), False),
        (ValueError("not a number in the dump"), False),
    ],
    ids=lambda value: getattr(type(value), "__name__", None),
)
def test_only_a_reason_is_no_failure(monkeypatch, raised, sound):
    def fails(*_):
        raise raised

    monkeypatch.setattr(survival, "_theirs", fails)
    outcome, found = survival._judge_other("lammps", TRIAL)
    assert found is sound
    assert str(raised) in outcome


def test_what_no_other_can_be_told_is_not_computed():
    def breaks(setting):
        setting.simulation(dataclasses.replace(edges.pair(), sleep=True))
        raise AssertionError("it is")

    case = Case("trial", "sleeps", breaks, (Setting("serial"),))
    rows = list(survival.judge(case, ["ours", "liggghts", "lammps"]))
    assert [(code, sound) for code, _, sound in rows] == [("liggghts", None), ("lammps", None)]
    assert all("cannot say it" in outcome for _, outcome, _ in rows)


def test_a_case_that_misses_its_bound_or_raises_is_a_failure_here():
    missed = Case("trial", "missed", lambda _: [Held("energy", 2.0, 1.0)], (Setting("serial"),))
    raised = Case("trial", "raised", lambda _: [1 / 0], (Setting("serial"),))
    rows = [row for case in (missed, raised) for row in survival.judge(case, ["ours"])]
    assert rows == [
        ("ours", "energy: 2 of 1", False),
        ("ours", "breaks, ZeroDivisionError: division by zero", False),
    ]


def end(**changed):
    """That of two spheres that have met, but for what is ``changed``, in column 0 to 8."""
    rows = np.zeros((2, 9))
    rows[:, 0], rows[:, 3] = (-1.0, 1.0), (-0.1, 0.1)
    for column, value in changed.items():
        rows[1, int(column[1:])] = value
    return rows


@pytest.mark.parametrize(
    ("rows", "missed"),
    [
        (end(), None),
        (end(c0=-2.0), "spheres through a wall"),
        (end(c7=np.nan), "numbers not finite"),
        (end(c4=1.0), "energy made"),
        (end()[:1], "spheres gone"),
    ],
)
def test_what_others_must_keep(monkeypatch, rows, missed):
    wall = dem.Plane((-1.5, 0, 0), (1, 0, 0), edges.GLASS)
    scene = dataclasses.replace(edges.pair(), boundaries=(wall,))
    trial = SimpleNamespace(sim=SimpleNamespace(scene=scene), dt=1e-6, steps=10, held=0.0)
    monkeypatch.setattr(survival, "_theirs", lambda *_: rows)
    outcome, sound = survival._judge_other("lammps", trial)
    assert sound is (missed is None)
    assert (missed or "energy -") in outcome


@pytest.mark.parametrize(
    ("script", "kind"),
    [
        ("echo 'ERROR: Lost atoms'; exit 1", survival.PeerStoppedError),
        ("exit 1", survival.PeerCrashedError),
        ("echo 'ERROR: late'; kill -SEGV $$", survival.PeerCrashedError),
        ("kill -XCPU $$", survival.PeerCrashedError),
    ],
)
def test_a_peer_that_names_no_reason_has_crashed(monkeypatch, tmp_path, script, kind):
    program = tmp_path / "peer"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setitem(peers.BINARIES, "lammps", str(program))
    with pytest.raises(kind):
        survival._theirs("lammps", edges.pair(), 1e-6, 10)


@pytest.mark.parametrize(
    ("a", "b"), [((5e7, 0.22), (1e5, 0.5)), ((1e9, -0.9), (1e9, 0.0)), ((1.0, 0.3), (1.0, 0.3))]
)
def test_lammps_is_told_of_a_material_that_is_alike(a, b):
    pair = [dem.Material(name, 1000, *each) for name, each in (("a", a), ("b", b))]
    one = dem.Material("one", 1000, *lammps.alike(*pair))
    for modulus in (elasticity.effective_youngs_modulus, elasticity.effective_shear_modulus):
        assert modulus(one, one) == pytest.approx(modulus(*pair), rel=1e-12)


def test_lammps_is_told_how_a_piston_travels():
    rows, dt = ((0.5, 0.2), (1.5, 0.2), (2.0, -0.1)), 0.125
    piston = dem.Piston((0, 0, 0), (0, 0, 1), edges.GLASS, program=rows)
    formula = lammps._travel(piston, dt)
    for step in range(20):
        expected = np.interp(step * dt, *np.transpose([(0, 0), *rows]))
        assert eval(formula, {"step": step}) == pytest.approx(expected, abs=1e-12)
        assert invariants.travelled(piston, step * dt) == pytest.approx(expected, abs=1e-12)


def thrown(velocity, wall, gravity=(0, 0, 0), friction=0.0, height=1.01, restitution=1.0):
    """A sphere against one wall."""
    law = dem.Law(dem.Hertz(restitution), dem.Mindlin(friction))
    ball = dem.Spheres([[0, 0, height * edges.R]], edges.R, edges.GLASS, velocity)
    return dem.Scene(spheres=ball, law=law, boundaries=[wall], gravity=gravity)


ASLANT = dem.Plane((0, 0, 0), (0.6, 0, 0.8), edges.GLASS)
RISES = dem.Piston((0, 0, 0), (0, 0, 1), edges.GLASS, program=((1e-3, 0.0), (1e-2, 9e-4)))
BELT = dem.Plane((0, 0, 0), (0, 0, 1), edges.GLASS, velocity=(0.2, 0, 0))


@pytest.mark.peers
@pytest.mark.parametrize(
    ("codes", "scene", "steps", "expected"),
    [
        (("lammps",), thrown((0, 0, -0.1), ASLANT, height=1.3), 5000, (0.096, 0, 0.028)),
        (tuple(peers.BINARIES), thrown((0, 0, 0), RISES), 2500, (0, 0, 0.2)),
        (
            tuple(peers.BINARIES),
            thrown((0, 0, 0), BELT, (0, 0, -9.81), 0.5, height=1.0, restitution=0.5),
            20_000,
            (0.4 / 7, 0, 0),
        ),
    ],
    ids=["aslant", "a piston that sets out late", "a belt"],
)
def test_others_are_told_of_walls(codes, scene, steps, expected):
    """It is thrown back in a mirror, by twice the piston's speed, and rolls on the belt."""
    there = [code for code in codes if peers.available(code)]
    if not there:
        pytest.skip(f"none of {', '.join(codes)} is installed")
    for code in there:
        (row,) = survival._theirs(code, scene, 4e-6, steps)
        np.testing.assert_allclose(row[3:5], expected[:2], atol=1e-3 * np.linalg.norm(expected))
        off = 1e-3 * np.linalg.norm(expected) if scene.gravity[2] == 0 else 5e-3
        np.testing.assert_allclose(row[5], expected[2], atol=off)


@pytest.mark.peers
def test_every_hard_scene_survives_here_and_elsewhere_is_told(capsys):
    if not any(peers.available(code) for code in peers.BINARIES):
        pytest.skip("neither LIGGGHTS nor LAMMPS is installed")
    missed = run.main(["survival"])
    printed = capsys.readouterr().out
    assert not missed, printed
    for code in filter(peers.available, peers.BINARIES):
        (line,) = (line for line in printed.splitlines() if f"cases run by {code}" in line)
        assert float(line.split()[4]) > 20


def test_every_benchmark_is_listed(capsys):
    assert run.main([]) == 0
    printed = capsys.readouterr().out
    assert all(name in printed for name in run.NAMES)


def test_bed_rests_on_its_floor(bed, settled):
    low = np.array([0.0, 0.0, 0.0])
    assert (bed.position > low).all()
    assert (bed.position[:, :2] < [bed.length, bed.width]).all()
    assert settled.largest_overlap() < 0.01
    weight = settled.particles.mass.sum() * beds.GRAVITY
    push = -sum(np.array(boundary.force) for boundary in settled.boundaries)
    assert push[2] == pytest.approx(weight, rel=1e-3)
    assert np.abs(push[:2]).max() < 1e-3 * weight
    assert beds.motion(settled) < beds.AT_REST


def test_copies_in_a_row_do_not_meet(bed):
    row = beds.side_by_side(bed, 3)
    assert row.count == 3 * FEW
    assert row.length == pytest.approx(3 * bed.length)
    copy = np.arange(row.count) // FEW
    gap = np.linalg.norm(row.position[:, None] - row.position[None], axis=2)
    gap -= row.radius[:, None] + row.radius[None]
    assert gap[copy[:, None] != copy[None]].min() > -0.01 * beds.RADIUS


def test_figure_judges_its_target():
    median = report.Figure.median("speed", [3.0, 1.0, 2.0], "M/s", at_least=2.0)
    assert median.value == 2.0
    assert median.met is True
    assert report.Figure("size", 5.0, "B", at_most=4.0).met is False
    assert report.Figure("time", 5.0, "s").met is None
    text = report.table([median, report.Figure("size", 5.0, "B", at_most=4.0)])
    assert "1 .. 3" in text
    assert text.count("met") == 1
    assert text.count("MISSED") == 1


def test_the_table_of_costs_goes_between_its_marks(tmp_path):
    rubs = Cost("friction", on=(3.0, 2.0, 4.0), off=(2.0, 2.0, 2.0))
    rolls = Cost("rolling", on=(3.0, 2.0, 4.0), off=(1.0, 1.0, 1.0))
    stopped = Cost("adhesion", problem="too deep")
    sleeps = Cost("sleep", on=(1.0, 1.0), off=(20.0, 20.0))
    layer = Cost("layer", on=(3.0, 2.0, 4.0), off=(0.25, 0.25, 0.25))
    bed = effect_costs.Found([rubs, stopped], [sleeps], {"rolling": "smooth", "layer": "no ground"})
    powder = effect_costs.Found([rubs, rolls], [layer], {"adhesion": "dry", "sleep": "moves"})
    found = {"bed": bed, "powder": powder}
    table = effect_costs.markdown(found)
    assert "| friction | +50% (+0% … +100%) | +50% (+0% … +100%) |" in table
    assert "| rolling | – smooth | +200% (+100% … +300%) |" in table
    assert "| adhesion | stopped | – dry |" in table
    assert "| a step with all of these | 3e+06 µs | 3e+06 µs |\n| sleep | -95%" in table
    assert "| layer | – no ground | ×12 (8 … 16) |" in table
    told = {figure.what: figure.value for figure in effect_costs.figures("bed", bed)}
    assert told["bed: with over without sleep"] == 0.05
    document = tmp_path / "effects.md"
    document.write_text(f"before\n{effect_costs.BEGIN}old\n{effect_costs.END}after\n")
    effect_costs.write(document, table)
    effect_costs.write(document, table)
    expected = f"before\n{effect_costs.BEGIN}{table}{effect_costs.END}after\n"
    assert document.read_text() == expected
    document.write_text("no marks")
    with pytest.raises(ValueError, match="does not have the lines"):
        effect_costs.write(document, table)


@pytest.mark.peers
@pytest.mark.parametrize("code", list(peers.BINARIES))
def test_peers_hold_the_same_bed(code, bed, settled):
    if not peers.available(code):
        pytest.skip(f"{peers.BINARIES[code]} or {peers.LAUNCHER[0]} is not installed")
    skin = 0.2 * beds.RADIUS
    timing = peers.run(code, beds.scene(bed), beds.TIME_STEP, 1000, 1000, skin, ranks=1)
    assert timing.contacts == (settled.contacts()["j"] >= 0).sum()
    assert timing.seconds > 0
    weight = settled.particles.mass.sum() * beds.GRAVITY
    assert timing.kinetic_energy < beds.AT_REST * weight * beds.RADIUS
    assert math.isfinite(timing.kinetic_energy)
