"""Scene files: exact round trips, overrides, and all mistakes at once, each with its key."""

import dataclasses
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taichi_dem.run_plan import Run
from taichi_dem.scene import Box, Material, Piston, Plane, Scene, Spheres, Substrate
from taichi_dem.scene_file import read
from taichi_dem.scene_writer import write
from taichi_dem.substrate import BASES, Layer, Relaxation
from taichi_dem.tables import override
from taichi_dem.toml_text import toml_text
from taichi_dem.validation import InputError, parameter, validate

GEL = Material("gel", density=1050, youngs_modulus=2e4, poissons_ratio=0.49)
GLASS = Material("glass", density=2500, youngs_modulus=5e7, poissons_ratio=0.22)


@dataclasses.dataclass(frozen=True)
class Spring:
    restitution: float = parameter("-", "rebound / impact", above=0, at_most=1)
    mode: str = "tangent"
    strict: bool = False
    limit: float | None = parameter("N", "largest force", default=None, above=0)

    def __post_init__(self):
        validate(self)


@dataclasses.dataclass(frozen=True)
class Friction:
    friction: float = parameter("-", "Coulomb coefficient", at_least=0)

    def __post_init__(self):
        validate(self)


@dataclasses.dataclass(frozen=True)
class Law:
    normal: Any
    tangential: Any = None
    pairs: dict = dataclasses.field(default_factory=dict)


LAWS = SimpleNamespace(
    Law=Law, LAWS={"normal": {"Spring": Spring}, "tangential": {"Friction": Friction}}
)

TEXT = """
gravity = [0.0, 0.0, -9.81]
[materials.gel]
density = 1050
youngs_modulus = 2e4
poissons_ratio = 0.49
[materials.glass]
density = 2500
youngs_modulus = 5e7
poissons_ratio = 0.22
[spheres]
material = "glass"
generate = {radius = 1e-3, region = [[0,0,0.001],[0.02,0.02,0.05]], count = 30, seed = 1}
[[boundaries]]
type = "Box"
low = [0.0, 0.0, -inf]
high = [0.02, 0.02, inf]
material = "glass"
[[boundaries]]
type = "Piston"
point = [0, 0, 0.06]
normal = [0, 0, -1]
material = "glass"
program = [[0.3, 0.01], [0.6, 0]]
[substrate]
material = "gel"
exchange = "implicit"
[law.normal]
type = "Spring"
restitution = 0.6
[law.tangential]
type = "Friction"
friction = 0.3
[[law.pairs]]
materials = ["glass", "gel"]
tangential.friction = 0.8
[run]
duration = 0.5
dt = 1e-6
frames = 0.01
"""


@pytest.fixture
def path(tmp_path):
    (tmp_path / "scene.toml").write_text(TEXT)
    return tmp_path / "scene.toml"


def message(path, *overrides):
    with pytest.raises(InputError) as caught:
        read(path, overrides, LAWS)
    return str(caught.value).splitlines()


def test_a_file_is_the_scene_that_python_would_make(path):
    scene, run = read(path, laws=LAWS)
    assert scene == Scene(
        spheres=Spheres.generate(
            GLASS, radius=1e-3, region=((0, 0, 0.001), (0.02, 0.02, 0.05)), count=30, seed=1
        ),
        boundaries=[
            Box((0, 0, -math.inf), (0.02, 0.02, math.inf), GLASS),
            Piston((0, 0, 0.06), (0, 0, -1), GLASS, program=((0.3, 0.01), (0.6, 0))),
        ],
        substrate=Substrate(GEL),
        law=Law(
            Spring(0.6), Friction(0.3), pairs={("glass", "gel"): {"tangential": Friction(0.8)}}
        ),
    )
    assert run == Run(duration=0.5, dt=1e-6, frames=0.01)


def test_the_package_s_own_laws_are_the_default(path):
    scene = Scene.from_toml(path, ["law.normal.type=Hertz", "law.tangential.type=Mindlin"])
    assert type(scene.law.normal).__name__ == "Hertz"
    assert scene.law.tangential.friction == 0.3
    scene.to_toml(path)
    assert Scene.from_toml(path) == scene


def test_overrides_replace_and_add_entries(path):
    scene, run = read(
        path,
        [
            "law.normal.restitution = 0.9",
            "law.normal.mode=constant",
            "law.pairs[0].tangential.friction=0.5",
            "boundaries[1].normal[2]=-2",
            "substrate.residual=1e-9",
            "run.history=0.1",
            "spheres.generate={radius=1e-3,region=[[0,0,0],[0.01,0.01,0.01]],count=2}",
        ],
        LAWS,
    )
    assert scene.law.normal == Spring(0.9, mode="constant")
    assert scene.law.pairs == {("glass", "gel"): {"tangential": Friction(0.5)}}
    assert scene.boundaries[1].normal == (0, 0, -2)
    assert scene.substrate == Substrate(GEL, residual=1e-9)
    assert run.history == 0.1 and scene.spheres.count == 2


def test_all_mistakes_are_reported_at_once_with_their_keys(path):
    lines = message(
        path,
        "boundaries[5].normal=1",
        "foo",
        "lwa.x=3",
        "materials.gel.density=-1",
        "spheres.radius=3",
        "spheres.generate.count=-1",
        "boundaries[0].material=glas",
        "boundaries[1].normal=[0,0,0]",
        "boundaries[1].program[1]=[0.2,1]",
        "substrate.exchange=lagd",
        "law.normal.restitution=2",
        "law.tangential.fricton=3",
        "run.steps=0",
    )
    assert lines == [
        "boundaries[5].normal = 1: there is no such place in the file",
        "--set = foo: must be KEY=VALUE, like law.normal.restitution=0.5",
        "lwa = {'x': 3}: unknown key; did you mean 'law'? known: gravity, period, sleep, "
        "materials, spheres, boundaries, substrate, law, run",
        "materials.gel.density = -1: must be > 0 kg/m3 (density)",
        "spheres.radius = 3: unknown key; known: generate, material, velocity, omega",
        "spheres.generate.count = -1: must be a whole number >= 1",
        "boundaries[0].material = glas: unknown material; did you mean 'glass'? known: gel, glass",
        "boundaries[1].normal = (0.0, 0.0, 0.0): must not be the zero vector",
        "boundaries[1].program[1] = [0.2, 1.0]: times must be >= 0 s and increase",
        "substrate.exchange = lagd: unknown choice; did you mean 'lagged'? "
        "known: implicit, lagged, none",
        "law.normal.restitution = 2: must be > 0 and <= 1 (rebound / impact)",
        "law.tangential.fricton = 3: unknown key; did you mean 'friction'? known: friction",
        "law.pairs[0].tangential: changes a law that is not given, or not right, for all pairs",
        "run.steps = 0: must be a whole number >= 1",
    ]


@pytest.mark.parametrize(
    ("overrides", "lines"),
    [
        (
            ["materials=3", "spheres=3", "boundaries=3", "substrate=1", "law=4", "run=2"],
            [
                "materials = 3: must be a table",
                "spheres = 3: must be a table",
                "boundaries = 3: must be a list of tables [[boundaries]]",
                "substrate = 1: must be a table",
                "law = 4: must be a table",
                "run = 2: must be a table",
            ],
        ),
        (
            ["materials.gel={density=-3}"],
            [
                "materials.gel.youngs_modulus: is missing; must be > 0 Pa (Young's modulus)",
                "materials.gel.poissons_ratio: is missing; "
                "must be > -1 and <= 0.5 (Poisson's ratio)",
                "materials.gel.density = -3: must be > 0 kg/m3 (density)",
            ],
        ),
        (
            ["spheres={}"],
            ["spheres: must have exactly one of position, generate, file, lammps_data; has none"],
        ),
        (
            ["spheres.file=a.csv"],
            [
                "spheres: must have exactly one of position, generate, file, lammps_data; "
                "has generate, file"
            ],
        ),
        (
            ["spheres={position=[[0,0,1],[0,0,2]],radius=[1,-1],material=['gel','gla']}"],
            [
                "spheres.material[1] = gla: unknown material; did you mean 'glass'? "
                "known: gel, glass",
                "spheres.radius[1] = -1.0: must be > 0 m (radius)",
            ],
        ),
        (
            ["spheres={position=[[0,0,1]],material='gel'}"],
            ["spheres.radius: must be numbers of shape (1,), in m"],
        ),
        (
            ["spheres={file='a.txt',material='gel'}"],
            ["spheres.file = a.txt: must end in .csv or .npz"],
        ),
        (
            ["law={}", "boundaries[0].type=Bx"],
            [
                "boundaries[0].type = Bx: unknown type; did you mean 'Box'? "
                "known: Plane, Box, Piston",
                "law.normal: is missing; its type must be one of Spring",
            ],
        ),
        (["law.pairs=[3]"], ["law.pairs[0] = 3: must be a table"]),
        (
            ["law.pairs=[{materials=['gel']},{materials=['gel','gels']}]"],
            [
                "law.pairs[0].materials = ['gel']: must be the names of two materials",
                "law.pairs[1].materials = gels: unknown material; did you mean 'gel'? "
                "known: gel, glass",
            ],
        ),
        (
            ["law.pairs=[{materials=['gel','glass']},{materials=['glass','gel']}]"],
            ["law.pairs[1].materials = ['glass', 'gel']: this pair was given before"],
        ),
        (
            ["law.pairs[0].normal={restitution=3, mod=1}", "law.pairs[0].rolling={}"],
            [
                "law.pairs[0].rolling = {}: unknown key; known: materials, normal, tangential",
                "law.pairs[0].normal.mod = 1: unknown key; did you mean 'mode'? "
                "known: restitution, mode, strict, limit",
                "law.pairs[0].normal.restitution = 3: must be > 0 and <= 1 (rebound / impact)",
            ],
        ),
        (
            ["substrate.layer={thickness=0, bas=1}"],
            [
                "substrate.layer.bas = 1: unknown key; did you mean 'base'? known: thickness, base",
                "substrate.layer.thickness = 0: must be > 0 m (thickness)",
            ],
        ),
        (
            ["substrate.relaxation.relaxed_modulus=0"],
            [
                "substrate.relaxation.retardation_time: is missing; must be > 0 s (time of creep "
                "under a constant load)",
                "substrate.relaxation.relaxed_modulus = 0: must be > 0 Pa (Young's modulus at "
                "rest)",
            ],
        ),
        (
            ["substrate.layer.thickness=1e-3", "substrate.exchange=none"],
            ['substrate.layer: must be left out with exchange = "none", a plane'],
        ),
        (
            ["substrate.coupling=none"],
            [
                "substrate.coupling = none: must be one of finite, point; for contacts that do not "
                'feel each other, exchange = "none"'
            ],
        ),
        (["gravity=1"], ["gravity = 1: must be three finite numbers"]),
        (
            ["period=[1]"],
            ["period = [1]: must be two finite lengths > 0 m, [Lx, Ly], or left out"],
        ),
    ],
)
def test_mistakes_name_key_value_and_rule(path, overrides, lines):
    assert message(path, *overrides) == lines


def test_a_replaced_length_takes_the_place_of_the_other(path):
    assert read(path, ["run.steps=3"], LAWS)[1].duration is None
    assert read(path, ["run.steps=3", "run.duration=1"], LAWS)[1].steps is None
    steps = path.with_name("steps.toml")
    steps.write_text(path.read_text().replace("duration = 0.5", "steps = 3"))
    assert read(steps, [], LAWS)[1].steps == 3
    plan = read(steps, [], LAWS, 0.1)[1]
    assert (plan.duration, plan.steps) == (0.1, None)


def test_a_length_is_given_once(path):
    for text in ("run.steps=100", " run.duration = 0.2"):
        with pytest.raises(InputError) as error:
            read(path, ["gravity=1", text], LAWS, 0.1)
        said = str(error.value).splitlines()
        assert said[0] == f"--duration = 0.1: --set {text} says how long, too; give one of them"
        assert said[1].startswith("gravity = 1: ") and len(said) == 2


def test_what_is_left_out_is_asked_for_in_words_of_the_file(path):
    path.write_text("[materials]")
    lines = message(path)
    assert lines == [
        "spheres: is missing: write [spheres] with one of position, generate, file, lammps_data",
        'law: is missing: write [law], and in it, say, normal = { type = "Hertz", '
        "restitution = 0.5 }",
    ]


def test_what_is_not_toml_is_refused(path):
    path.write_text("gravity = [1,")
    assert "scene.toml: cannot be read: " in message(path)[0]
    path.write_bytes(b"gravity = 1 # \xff")
    assert message(path) == [f"{path}: must be text in UTF-8; byte 14 is not"]
    assert message(path.with_name("none.toml")) == [
        f"{path.with_name('none.toml')}: there is no such file"
    ]
    assert message(path.parent) == [f"{path.parent}: is a folder; must be a file"]


def test_mistakes_of_all_stages_come_at_once(path):
    (path.parent / "two.csv").write_text("x,y,z,radius,material\n0,0,1,-1e-3,gold\n0,0,2,1,gel\n")
    lines = message(
        path,
        "gravity=[0,0,nan]",
        "sleep=yes",
        "period=[1]",
        "substrate.exchange_every=2.5",
        "materials.glass.density='2500'",
        "spheres={file='two.csv'}",
        "=1",
        "boundaries[0].low=1",
    )
    assert [line.partition(":")[0] for line in lines] == [
        "--set = =1",
        'materials.glass.density = "2500"',
        "spheres.radius[0] = -0.001",
        "spheres.material = gold",
        "boundaries[0].low = 1",
        "substrate.exchange_every = 2.5",
        "gravity = [0, 0, nan]",
        "period = [1]",
        "sleep = yes",
    ]


def test_the_state_that_a_run_has_left_is_taken_up(path):
    places = np.array([[0.01, 0.01, 0.01], [0.01, 0.01, 0.02]])
    state = {"time": 3.0, "step": 7, "force": places, "radius": [1e-3, 2e-3], "position": places}
    state |= {"velocity": places, "omega": -places}
    names = {"material": [1, 0], "material_names": ["gel", "glass", "other"]}
    np.savez(path.parent / "state.npz", **state, **names)
    spheres = read(path, ["spheres={file='state.npz'}"], LAWS)[0].spheres
    assert spheres == Spheres(places, [1e-3, 2e-3], (GLASS, GEL), places, -places)
    np.savez(path.parent / "other.npz", **state)
    [line] = message(path, "spheres={file='other.npz', material='gel'}")
    assert line.startswith(f"spheres.file = {path.parent / 'other.npz'}: unknown array 'time'; ")


def test_spheres_from_files_beside_the_scene(path):
    spheres = Spheres([[0.01, 0.01, 0.01]], 1e-3, GEL, velocity=(0, 0, -1))
    spheres.to_npz(path.with_name("s.npz"))
    path.with_name("s.csv").write_text("x,y,z,radius,vx,vy,vz\n0.01,0.01,0.01,1e-3,0,0,-1\n")
    path.with_name("s.data").write_text(
        "title\n1 atoms\n\nAtoms\n\n1 1 2e-3 1050 0.01 0.01 0.01\n\nVelocities\n\n1 0 0 -1 0 0 0\n"
    )
    for table in (
        "{file='s.npz'}",
        "{file='s.csv', material='gel'}",
        "{lammps_data='s.data', materials={1='gel'}}",
        "{lammps_data='s.data', materials='gel'}",
        "{position=[[0.01,0.01,0.01]], radius=1e-3, velocity=[0,0,-1], material='gel'}",
    ):
        assert read(path, [f"spheres={table}"], LAWS)[0].spheres == spheres
    [line] = message(path, "spheres={lammps_data='s.data', materials={a='gel',1='gel'}}")
    assert line == "spheres.materials.a = gel: must be under an atom type: 1, 2 …"
    [line] = message(path, "spheres={file='s.csv'}")
    assert "names no materials" in line
    path.with_name("n.csv").write_text("x,y,z,radius,material\n0.01,0.01,0.01,1e-3,glass\n")
    [line] = message(path, "spheres={file='n.csv', material='gel'}")
    assert line.endswith("known: gel; leave spheres.material out where the file names materials")
    path.with_name("b.npz").write_text("x,y,z,radius\n")
    [line] = message(path, "spheres={file='b.npz', material='gel'}")
    assert "must be an .npz archive" in line and "position (n, 3)" in line and "pickle" not in line


@pytest.mark.parametrize(
    ("wrong", "line"),
    [
        ({"duration": 0}, "run.duration = 0: must be > 0 s (simulated time)"),
        ({"steps": 1.5}, "run.steps = 1.5: must be a whole number >= 1"),
        ({"steps": True}, "run.steps = True: must be a whole number >= 1"),
        ({"duration": 1, "steps": 1}, "run.steps = 1: give duration or steps, not both"),
        ({"dt": -1}, "run.dt = -1: must be > 0 s (time step)"),
        ({"frames": 0}, "run.frames = 0: must be > 0 s (time between frames)"),
        ({"history": 0}, "run.history = 0: must be > 0 s (time between lines)"),
    ],
)
def test_run_refuses(wrong, line):
    with pytest.raises(InputError) as caught:
        Run(**wrong)
    assert str(caught.value) == line


def floats(*limits, **more):
    """Without subnormal numbers: once the kernel compiler runs, the processor takes them as 0."""
    return st.floats(*limits, allow_subnormal=False, **more)


numbers = floats(allow_nan=False, allow_infinity=False, width=64)
positive = floats(min_value=0, exclude_min=True, allow_infinity=False)
names = st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=5)


@st.composite
def scenes(draw):
    """Scenes with any floats and names; spheres far enough apart, boundaries out of the way."""
    kinds = [
        Material(name, draw(positive), draw(positive), draw(floats(-1, 0.5, exclude_min=True)))
        for name in draw(st.lists(names, min_size=2, max_size=4, unique=True))
    ]
    material = st.sampled_from(kinds)
    n = draw(st.integers(1, 5))
    shift = draw(arrays := st.lists(floats(0, 0.1), min_size=3 * n, max_size=3 * n))
    grid = np.arange(n)[:, None] * [1.0, 0, 0] + [0, 0, 1]
    spheres = Spheres(
        grid + np.reshape(shift, (n, 3)),
        draw(st.lists(floats(0.1, 0.4), min_size=n, max_size=n)),
        draw(st.lists(material, min_size=n, max_size=n)),
        velocity=draw(st.none() | arrays.map(lambda v: np.reshape(v, (n, 3)))),
        omega=draw(st.lists(numbers, min_size=3, max_size=3)),
    )
    far, down = (0.0, 0.0, draw(floats(5, 1e300))), (0.0, 0.0, draw(floats(-1, -0.1)))
    motions = (
        st.fixed_dictionaries({"velocity": numbers})
        | st.fixed_dictionaries({"load": numbers, "mass": positive})
        | st.just({"program": ((0.1, draw(numbers)), (0.7, 1 / 3))})
    )
    walls = st.one_of(
        st.builds(Plane, st.just(far), st.just(down), material, st.tuples(*[numbers] * 3)),
        st.builds(Box, st.just((-9.0, -math.inf, 0)), st.just((9, math.inf, 9e9)), material),
        motions.map(lambda m: Piston(far, down, kinds[0], **m)),
    )
    friction = draw(st.none() | st.builds(Friction, floats(0, 1e9)))
    layer = st.none() | st.builds(Layer, floats(1e-6, 1e6), st.sampled_from(BASES))
    pair = {"normal": Spring(draw(floats(0.1, 1)), "ü\n\"'", limit=draw(positive))}
    boundaries, period = draw(st.lists(walls, max_size=3)), None
    if not any(isinstance(wall, Box) for wall in boundaries):
        period = draw(st.none() | st.tuples(floats(7, 1e9), floats(2, 1e9)))
    return Scene(
        spheres=spheres,
        boundaries=boundaries,
        period=period,
        substrate=draw(st.none() | st.builds(Substrate, material, floats(1e-9, 0.5), layer=layer)),
        law=Law(
            Spring(0.5, strict=True),
            friction,
            {(spheres.materials[0].name, spheres.materials[-1].name): pair},
        ),
        gravity=tuple(draw(st.lists(numbers, min_size=3, max_size=3))),
    )


@settings(max_examples=60)
@given(scenes(), st.builds(Run, duration=positive) | st.builds(Run, steps=st.just(7), dt=positive))
def test_round_trip_is_exact(tmp_path_factory, scene, run):
    path = tmp_path_factory.mktemp("scene") / "scene.toml"
    write(path, scene, run)
    assert read(path, laws=LAWS) == (scene, run)


@settings(max_examples=20)
@given(floats(1, 1e6), floats(0.01, 1), floats(1e-6, 1e6), st.none() | floats(1e-6, 1e6))
def test_round_trip_of_ground_that_creeps(tmp_path_factory, modulus, share, time, thickness):
    from taichi_dem.contacts.hertz import Hertz
    from taichi_dem.contacts.law import Law

    soil = dataclasses.replace(GEL, youngs_modulus=modulus)
    layer = None if thickness is None else Layer(thickness)
    relaxation = Relaxation(min(share * modulus, modulus), time)
    ground = Substrate(soil, coupling="point", layer=layer, relaxation=relaxation)
    spheres = Spheres([[0.0, 0.0, 1.0]], 0.5, GLASS)
    scene = Scene(spheres=spheres, substrate=ground, law=Law(Hertz(0.5)))
    path = tmp_path_factory.mktemp("scene") / "scene.toml"
    write(path, scene)
    assert read(path)[0] == scene


def test_many_spheres_go_to_a_file_beside_the_scene(tmp_path):
    rng = np.random.default_rng(3)
    x = np.stack(np.meshgrid(*[np.arange(11.0)] * 3), axis=-1).reshape(-1, 3)
    spheres = Spheres(
        x, rng.uniform(0.1, 0.4, 1331), ((GEL, GLASS), rng.integers(0, 2, 1331)), omega=(1, 2, 3)
    )
    scene = Scene(spheres=spheres, law=Law(Spring(0.5)))
    write(tmp_path / "big.toml", scene)
    assert 'file = "big.spheres.npz"' in (tmp_path / "big.toml").read_text()
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    for file in list(tmp_path.glob("big.*")):
        file.rename(moved / file.name)
    assert read(moved / "big.toml", laws=LAWS) == (scene, Run())


def test_toml_text_is_tidy():
    document = {
        "b": [1, 2.5, True],
        "none": None,
        "t": {"x": {"y": 'q"\n'}},
        "rows": [[1.0, 2.0], [3.0, math.inf]],
        "list": [{"a": 1}, {}],
        "empty": {},
    }
    assert toml_text(document) == (
        "b = [1, 2.5, true]\nrows = [\n  [1.0, 2.0],\n  [3.0, inf],\n]\n"
        '\n[t.x]\ny = "q\\"\\n"\n\n[[list]]\na = 1\n\n[[list]]\n\n[empty]\n'
    )


def test_override_reaches_into_tables_and_lists():
    document = {"a": {"b": [1, {"c": 2}]}, "s": "text"}
    assert override(document, "a.b[1].c", 5) is None
    assert override(document, "x.y", 6) is None
    assert document == {"a": {"b": [1, {"c": 5}]}, "s": "text", "x": {"y": 6}}
    for path in ("a.b[2]", "a.b.c", "s.t", "s[0]", "a.b[0].x"):
        assert override(document, path, 0).path == path
