"""The command line as a user meets it: exit codes, what is written, what is said."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import taichi_dem as dem
from taichi_dem import cli, oddities, wording
from taichi_dem import folder as folders
from taichi_dem.frames import read_index
from taichi_dem.output import read_history
from taichi_dem.snapshot import Snapshot

ROOT = Path(__file__).parents[2]
PICTURES = {"overview.png", "bed.png", "depression.png", "energy.png"}
SCENE = """
gravity = [0, 0, -9.81]

[materials.glass]
density = 2500
youngs_modulus = 5e6
poissons_ratio = 0.22

[materials.gel]
density = 1050
youngs_modulus = 5e4
poissons_ratio = 0.49

[spheres]
material = "glass"
radius = 1e-3
position = [[0, 0, 1e-3], [2.5e-3, 0, 1e-3], [1.2e-3, 0, 3e-3]]

[[boundaries]]
type = "Plane"
point = [0, 0, 6e-3]
normal = [0, 0, -1]
material = "glass"

[substrate]
material = "gel"

[law]
normal = { type = "Hertz", restitution = 0.6 }
tangential = { type = "Mindlin", friction = 0.3 }

[run]
duration = 1e-3
"""


def process(*arguments):
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "taichi_dem", *map(str, arguments)]
    return subprocess.Popen(
        command, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def outcome(folder):
    return json.loads((folder / "summary.json").read_text())["outcome"]


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run by the installed program's own process: folder, standard output and error."""
    folder = tmp_path_factory.mktemp("finished")
    (folder / "scene.toml").write_text(SCENE)
    run = process("run", folder / "scene.toml", "-o", folder / "out")
    out, err = run.communicate()
    assert run.returncode == cli.DONE, err
    return folder / "out", out, err


# Help


def test_help_loads_nothing_heavy():
    code = (
        "import sys\n"
        "from taichi_dem import cli\n"
        "try:\n    cli.main(['run', '--help'])\n"
        "except SystemExit as end:\n    print('\\nEND', end.code, *sys.modules)"
    )
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env)
    said, _, rest = out.stdout.rpartition("END ")
    assert "--overwrite" in said and rest.split()[0] == "0"
    assert not set(rest.split()) & {"numpy", "scipy", "taichi", "quadrants", "matplotlib", "tqdm"}


def test_a_command_must_be_one_that_exists(capsys):
    with pytest.raises(SystemExit) as end:
        cli.main(["fly"])
    assert end.value.code == cli.WRONG_INPUT
    assert "'fly'" in capsys.readouterr().err


# Run


def test_run_writes_a_folder_that_can_be_read(finished):
    folder, _, _ = finished
    written = {path.name for path in folder.iterdir()}
    assert written >= PICTURES
    assert {"scene.toml", "history.csv", "summary.json", "state.npz"} <= written
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["outcome"] == "finished"
    on = {name for name, effect in summary["effects"].items() if effect["on"]}
    assert on >= {"friction", "rotation", "substrate coupling"}
    assert {name for name, one in summary["effects"].items() if "share_of_step" in one} == on
    assert all(summary["effects"][name]["share_of_step"] is None for name in on)
    assert summary["simulated_time_s"] == pytest.approx(1e-3, abs=summary["dt_s"])
    history, state = read_history(folder), Snapshot.load(folder)
    assert history["step"][-1] == summary["steps"] == state.step
    assert np.all(np.diff(history["step"]) > 0)
    assert dem.Scene.from_toml(folder / "scene.toml").spheres.count == 3


def test_run_says_what_happened_and_nothing_of_the_compiler(finished):
    folder, out, err = finished
    summary = json.loads((folder / "summary.json").read_text())
    assert f"finished: {wording.quantity(summary['simulated_time_s'], 's')} simulated" in out
    assert f"{summary['steps']:,} steps" in out
    for word in ("spheres", "contacts", "substrate", "energy", str(folder)):
        assert word in out
    assert "Taichi" not in out + err and "Traceback" not in err


def test_frames_default_to_a_hundred(finished):
    pytest.importorskip("vtkmodules")
    folder, _, _ = finished
    index = read_index(folder)
    steps, dt = (
        Snapshot.load(folder).step,
        json.loads((folder / "summary.json").read_text())["dt_s"],
    )
    every = max(1, round(1e-3 / 100 / dt))
    assert len(index) == steps // every + 1 + (steps % every > 0)
    assert all((folder / file).exists() for files in index.values() for file in files)


def test_a_run_is_replaced_only_when_asked(finished, tmp_path, capsys):
    folder = shutil.copytree(finished[0], tmp_path / "out")
    scene = folder / "scene.toml"
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert cli.main(["run", str(scene), "-o", str(folder), "--duration", "2e-4"]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert before == {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    (folder / "notes.txt").write_text("mine")
    (folder / "last_good.npz").write_text("of the run before")
    nearer = ["--set", "spheres.position[1]=[1.8e-3, 0, 1e-3]"]
    again = ["run", str(scene), "-o", str(folder), "--duration", "2e-4", "--overwrite", *nearer]
    assert cli.main(again) == cli.DONE
    said = capsys.readouterr()
    assert "warning: spheres 0 and 1 overlap by 200 µm at the start, 20% of the" in said.err
    assert read_history(folder)["time_s"][-1] == pytest.approx(2e-4, rel=0.1)
    assert (folder / "notes.txt").read_text() == "mine"
    assert not (folder / "last_good.npz").exists()
    frames = {file for files in read_index(folder).values() for file in files}
    assert {str(p.relative_to(folder)) for p in (folder / "frames").glob("*")} == frames


@pytest.mark.parametrize(
    "kind", ["folder of something else", "file", "link to a file", "link to nothing"]
)
@pytest.mark.parametrize("overwrite", [(), ("--overwrite",)])
def test_nothing_is_written_among_other_files(kind, overwrite, scene, tmp_path, capsys):
    target = tmp_path / "taken"
    if kind == "file":
        target.write_text("mine")
    elif kind.startswith("link"):
        target.symlink_to(scene if kind == "link to a file" else tmp_path / "nowhere")
    else:
        target.mkdir()
        (target / "thesis.txt").write_text("mine")
    before = {path: path.lstat().st_mtime_ns for path in tmp_path.rglob("*")}
    for command in (["run", *overwrite], ["study", "--duration", "1"]):
        assert cli.main([*command, str(scene), "-o", str(target)]) == cli.WRONG_INPUT
        said = capsys.readouterr()
        assert f"output = {target}" in said.err and "compiling" not in said.out
        assert before == {path: path.lstat().st_mtime_ns for path in tmp_path.rglob("*")}


def test_a_folder_that_nobody_can_make_is_refused_first(scene, tmp_path, capsys):
    if not Path("/proc/self").exists():
        pytest.skip("needs a file system on which nothing can be made, /proc")
    assert cli.main(["run", str(scene), "-o", "/proc/foo/deeper"]) == cli.WRONG_INPUT
    said = capsys.readouterr()
    assert "output = /proc/foo/deeper: cannot be written: " in said.err
    assert "compiling" not in said.out


def test_looking_whether_a_folder_can_be_made_leaves_none(tmp_path):
    before = sorted(tmp_path.rglob("*"))
    assert folders.unwritable(tmp_path / "new" / ".." / "other" / "deep") is None
    assert sorted(tmp_path.rglob("*")) == before


def test_an_index_that_names_other_files_takes_none_away(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "mine").write_text("mine")
    index = '<VTKFile><Collection><DataSet timestep="0" file="../mine"/></Collection></VTKFile>'
    (tmp_path / "run" / "frames.pvd").write_text(index)
    folders.clear(tmp_path / "run")
    assert (tmp_path / "mine").read_text() == "mine"
    assert not (tmp_path / "run" / "frames.pvd").exists()


# Mistakes


def test_every_mistake_is_named_and_nothing_is_written(scene, tmp_path):
    target = tmp_path / "out"
    run = process(
        *("run", scene, "-o", target),
        *("--set", "materials.gel.poissons_ratio=0.7"),
        *("--set", "law.normal.restitutoin=0.5"),
        *("--set", "spheres.radius=-1e-3"),
    )
    out, err = run.communicate()
    assert run.returncode == cli.WRONG_INPUT
    assert "materials.gel.poissons_ratio = 0.7: must be > -1 and <= 0.5" in err
    assert "law.normal.restitutoin = 0.5: unknown key; did you mean 'restitution'?" in err
    assert "spheres.radius = -0.001: must be > 0 m" in err
    assert "3 mistakes" in err
    assert "Traceback" not in err and "Taichi" not in out + err
    assert not target.exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--duration", "-1"], "run.duration = -1.0: must be > 0 s"),
        (
            ["--set", "run.steps=100", "--duration", "0.1"],
            "--duration = 0.1: --set run.steps=100 says how long, too; give one of them",
        ),
        (["--set", "gravity"], "--set = gravity: must be KEY=VALUE"),
        (["--set", "run.dt=1"], "run.dt = 1: must be at most the duration, "),
        (["--set", "spheres.velocity=[true]"], "spheres.velocity[0] = true: must be a number; "),
        (["--set", "=1"], "--set = =1: must be KEY=VALUE"),
        (["--set", "materials.gel.density='1'"], 'materials.gel.density = "1": must be a number'),
        (["--set", "law.normal=[true]"], "law.normal = [true]: must be a table"),
        (["--set", "run.dt=-1e-6"], "run.dt = -1e-06: must be > 0 s"),
    ],
)
def test_mistakes_on_the_command_line(arguments, said, scene, tmp_path, capsys):
    target = tmp_path / "out"
    assert cli.main(["run", str(scene), "-o", str(target), *arguments]) == cli.WRONG_INPUT
    assert said in capsys.readouterr().err
    assert not target.exists()


@pytest.mark.parametrize("under", ["scene.toml", "scene.toml/deeper"])
def test_a_folder_that_cannot_be_made_is_noticed_first(under, scene, capsys):
    assert cli.main(["run", str(scene), "-o", str(scene.parent / under / "x")]) == cli.WRONG_INPUT
    said = capsys.readouterr()
    assert "is a file, not a folder" in said.err and "compiling" not in said.out


def test_mistakes_are_told_in_the_words_of_the_file(scene, capsys):
    scene.write_text(SCENE.replace("[law]", "[law]\nsurface = {type = 'MultiContact'}"))
    pair = 'law.pairs=[{materials=["glass", "gel"], rolling={work_of_adhesion=1}}]'
    for settings, said in (
        (
            ["law.pairs=[{materials=['glass', 'gel'], surface={prefactor=1}}]"],
            "law.pairs[0].surface = { type = ",
        ),
        (
            ["law.rolling={type='CDTJKR', adhesion_hysteresis=1}"],
            "law.rolling.work_of_adhesion: is",
        ),
        (
            [
                "law.rolling={type='CDTJKR', adhesion_hysteresis=1, work_of_adhesion=1}",
                "law.normal={type='JKR', work_of_adhesion=1, restitution=1}",
                pair,
            ],
            "law.pairs[0].rolling.work_of_adhesion = ",
        ),
    ):
        arguments = [word for text in settings for word in ("--set", text)]
        assert cli.main(["check", str(scene), *arguments]) == cli.WRONG_INPUT
        told = capsys.readouterr().err
        assert said in told and "None" not in told and "(" not in told.split(said)[1][:10], told


def test_a_scene_must_say_how_long(scene, capsys):
    scene.write_text(SCENE.partition("[run]")[0])
    assert cli.main(["check", str(scene)]) == cli.WRONG_INPUT
    assert "run.duration: is missing" in capsys.readouterr().err


def test_a_file_that_is_not_there(tmp_path, capsys):
    assert cli.main(["run", str(tmp_path / "none.toml")]) == cli.WRONG_INPUT
    assert "none.toml: there is no such file\n" in capsys.readouterr().err
    assert cli.main(["check", str(tmp_path)]) == cli.WRONG_INPUT
    assert f"{tmp_path}: is a folder; must be a file\n" in capsys.readouterr().err


def test_a_wrong_environment_is_wrong_input(scene):
    env = {**os.environ, "PYTHONPATH": str(ROOT), "HALFSPACE_THREADS": "many"}
    command = [sys.executable, "-m", "taichi_dem", "check", str(scene)]
    run = subprocess.run(command, capture_output=True, text=True, env=env)
    assert run.returncode == cli.WRONG_INPUT
    assert "HALFSPACE_THREADS = many" in run.stderr and "Traceback" not in run.stderr


# Ends that are not the plan's


@pytest.mark.parametrize(
    "signals",
    [
        pytest.param([signal.SIGINT], id="ctrl-c", marks=pytest.mark.slow),
        pytest.param([signal.SIGTERM] * 2, id="timeout"),  # which tells the process, then its group
    ],
)
def test_an_interrupted_run_leaves_everything_on_disk(signals, scene, tmp_path):
    target = tmp_path / "out"
    settings = ["--set", "run.history=1e-4", "--set", "run.frames=1e-3", "--cost"]
    run = process("run", scene, "-o", target, "--duration", "1e4", *settings)
    try:
        history = target / "history.csv"
        while run.poll() is None and not (
            history.exists() and history.read_bytes().count(b"\n") > 5
        ):
            time.sleep(0.05)
        for number in signals:
            run.send_signal(number)
        out, err = run.communicate()
    finally:
        run.kill()
    assert run.returncode == cli.INTERRUPTED, err
    assert "interrupted" in out and "Traceback" not in err
    assert outcome(target) == "interrupted" and "timing" not in out
    rows, state = read_history(target), Snapshot.load(target)
    assert len(rows["step"]) > 4 and rows["step"][-1] == state.step
    glass = dem.Material("glass", density=2500, youngs_modulus=5e6, poissons_ratio=0.22)
    last = dem.Spheres.from_npz(target / "last_good.npz", glass)
    assert np.array_equal(last.position, state.position)
    assert all((target / f).exists() for files in read_index(target).values() for f in files)
    assert {path.name for path in target.glob("*.png")} == PICTURES


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_every_command_is_interrupted_also_in_the_background(number, scene, tmp_path):
    """A shell has what its scripts put there ignore Ctrl-C, and children inherit that."""
    target = tmp_path / "out"
    deaf = "import os, signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
    deaf += "os.execv(sys.executable, [sys.executable, '-m', 'taichi_dem', *sys.argv[1:]])"
    command = [sys.executable, "-c", deaf, "study", scene, "-o", target, "--duration", "1e-3"]
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    run = subprocess.Popen(command, env=env, stderr=subprocess.PIPE, text=True)
    try:
        while run.poll() is None and not (target / "study.csv").exists():
            time.sleep(0.05)
        run.send_signal(number)
        _, err = run.communicate()
    finally:
        run.kill()
    assert run.returncode == cli.INTERRUPTED and err == "taichi-dem: interrupted\n"
    assert (target / "study.txt").exists()


def test_signals_are_as_they_were_after_a_command(tmp_path):
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    assert cli.main(["plot", str(tmp_path / "none")]) != cli.DONE
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_a_guard_keeps_the_last_good_state(scene, tmp_path, capsys):
    target = tmp_path / "out"
    meet = ["--set", "spheres.velocity=[[5, 0, 0], [-5, 0, 0], [0, 0, 0]]"]
    soft = ["--set", "materials.glass.youngs_modulus=1e4", "--set", "run.history=1e-5"]
    assert cli.main(["run", str(scene), "-o", str(target), *meet, *soft, "--cost"]) == cli.STOPPED
    said = capsys.readouterr()
    assert "timing" not in said.out
    assert "overlaps sphere" in said.err and "Try" in said.err
    assert outcome(target).startswith("stopped")
    glass = dem.Material("glass", density=2500, youngs_modulus=1e4, poissons_ratio=0.22)
    good, state = dem.Spheres.from_npz(target / "last_good.npz", glass), Snapshot.load(target)
    np.testing.assert_array_equal(good.position, state.position)
    np.testing.assert_array_equal(good.velocity, state.velocity)
    apart = np.linalg.norm(good.position[0] - good.position[1])
    assert apart > 1e-3  # overlap below the limit of half a radius, plus a row of history
    assert {path.name for path in target.glob("*.png")} == PICTURES


# Check


def test_check_says_what_is_computed_and_writes_nothing(scene, tmp_path, capsys):
    before = sorted(tmp_path.rglob("*"))
    assert cli.main(["check", str(scene)]) == cli.DONE
    assert sorted(tmp_path.rglob("*")) == before
    said = capsys.readouterr().out
    volume = 3 * 4 / 3 * np.pi
    for text in (
        f"3, radius 1 mm, volume {volume:.1f} mm³, mass {volume * 2.5:.1f} mg",
        "gel: 1050 kg/m³, Young's modulus 50 kPa, Poisson's ratio 0.49",
        "0: Plane of glass",
        "normal law: Hertz(restitution=0.6)",
        "finite coupling), solved together at every step",
        "rotation: because friction makes torque",
        "history: of each contact: tangential_force",
        "dissipation: is summed up: friction, damping",
        "moving boundaries",
        "1/20 of the half period",
        "1 ms, ",
        "measured over",
        "for compiling",
        "for output",
    ):
        assert text in said, text
    assert said.splitlines()[-1].startswith("cost ") and "--cost" in said.splitlines()[-1]


def test_check_lists_what_a_scene_leaves_out(scene, capsys):
    plain = SCENE.replace('tangential = { type = "Mindlin", friction = 0.3 }', "")
    plain = plain.replace("restitution = 0.6", "restitution = 1").replace(
        '[substrate]\nmaterial = "gel"', ""
    )
    scene.write_text(plain)
    nearer = ["--set", "spheres.position[1]=[1.9e-3, 0, 1e-3]"]
    assert cli.main(["check", str(scene), *nearer]) == cli.DONE
    said = capsys.readouterr()
    (off,) = [line for line in said.out.splitlines() if line.startswith("off")]
    assert "warning: spheres 0 and 1 overlap by 100 µm" in said.err
    for absent in ("tangential", "substrate", "rotation", "history", "dissipation"):
        assert absent in off


def test_check_finds_a_run_that_would_be_stopped(scene, capsys):
    assert cli.main(["check", str(scene), "--set", "run.dt=0.02", "--duration", "1"]) == cli.STOPPED
    said = capsys.readouterr().err
    assert "beyond the stable step" in said and "the run would be stopped: at t =" in said


def test_a_scene_that_hardly_was_meant_is_doubted():
    glass = dem.Material("glass", density=2500, youngs_modulus=5e6, poissons_ratio=0.22)

    def said(apart, steps=1, radius=2e-3):
        row = np.arange(3)[:, None] * [apart, 0, 0] + [0, 0, 1]
        scene = dem.Scene(
            spheres=dem.Spheres(row, radius, glass), law=dem.Law(dem.Hertz(restitution=0.5))
        )
        return list(oddities.oddities(scene, steps, 1e-9, "the time that light takes"))

    assert said(3e-3) == [
        "spheres 0 and 1 overlap by 1 mm at the start, 50% of the smaller radius (2 pairs by more "
        "than 10%): they will fly apart unless they are held. Is a diameter given as a radius?"
    ]
    assert said(3.9e-3) == said(1.0, 10**9) == []
    [line] = said(3.7e-3, radius=[2e-3, 2e-3, 1e-3])
    assert line.startswith("spheres 0 and 1 overlap by 300 µm at the start, 15% of the smaller rad")
    assert "pairs" not in line
    assert said(1.0, 2 * 10**10) == [
        "2e+10 steps are more than can be waited for: dt = 1 ns, the time that light takes"
    ]


def test_memory_is_that_of_the_fields():
    from halfspace import backend
    from taichi_dem.memory import fields, size
    from taichi_dem.types import ti

    backend.start()

    class Owner:
        scalar, vector = ti.field(ti.f64), ti.Vector.field(3, ti.f32)
        struct = ti.types.struct(a=ti.types.vector(2, ti.f64), b=ti.i32).field()

    owner, builder = Owner(), ti.FieldsBuilder()
    vars(owner).update(scalar=Owner.scalar, vector=Owner.vector, struct=Owner.struct)
    builder.dense(ti.i, 10).place(owner.scalar)
    builder.dense(ti.ij, (4, 5)).place(owner.vector)
    builder.dense(ti.i, 7).place(owner.struct)
    tree = builder.finalize()
    assert size(owner.scalar) == 10 * 8
    assert size(owner.vector) == 20 * 3 * 4
    assert size(owner.struct) == 7 * (2 * 8 + 4)
    assert fields(owner) == 80 + 240 + 140
    tree.destroy()


# Plot


def test_plot_draws_a_run_again(finished, tmp_path, capsys):
    folder = shutil.copytree(finished[0], tmp_path / "out")
    for picture in folder.glob("*.png"):
        picture.unlink()
    assert cli.main(["plot", str(folder)]) == cli.DONE
    assert {path.name for path in folder.glob("*.png")} == PICTURES
    assert set(capsys.readouterr().out.split()) == {str(folder / name) for name in PICTURES}


@pytest.mark.parametrize("kind", ["missing", "empty", "damaged"])
def test_plot_refuses_what_is_not_a_run(kind, tmp_path, capsys):
    folder = tmp_path / "out"
    if kind != "missing":
        folder.mkdir()
    if kind == "damaged":
        (folder / "state.npz").write_bytes(b"PK")
    assert cli.main(["plot", str(folder)]) == cli.WRONG_INPUT
    assert f"folder = {folder}" in capsys.readouterr().err


# Words


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (wording.quantity(4.75e-6, "s"), "4.75 µs"),
        (wording.quantity(0.9996, "m"), "1 m"),
        (wording.quantity(0, "N"), "0 N"),
        (wording.quantity(-2e-9, "J"), "-2 nJ"),
        (wording.span([9e-4, 1.3e-3], "m"), "0.9 to 1.3 mm"),
        (wording.span([1e-3, 1.0000001e-3], "m"), "1 mm"),
        (wording.cubic(2.27e-6), "2.27 cm³"),
        (wording.cubic(1.2e-8), "12 mm³"),
        (wording.cubic(4e-15), "4,000 µm³"),
        (wording.mass(5.67e-3), "5.67 g"),
        (wording.mass(12.0), "12 kg"),
        (wording.memory(1.81e6), "1.81 MB"),
        (wording.clock(12.34), "12.3 s"),
        (wording.clock(245), "4 min 05 s"),
        (wording.clock(12000), "3 h 20 min"),
        (wording.clock(3 * 86400), "3 days"),
        (wording.count(1, "row"), "1 row"),
        (wording.count(2000, "row"), "2,000 rows"),
    ],
)
def test_numbers_in_words(text, expected):
    assert text == expected
