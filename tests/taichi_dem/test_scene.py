"""Scenes: what is stored; mistakes are refused with path, value and what would be right."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from taichi_dem.scene import Box, Material, Piston, Plane, Scene, Spheres, Substrate
from taichi_dem.substrate import Layer, Relaxation
from taichi_dem.validation import InputError

GEL = Material("gel", density=1050, youngs_modulus=2e4, poissons_ratio=0.49)
GLASS = Material("glass", density=2500, youngs_modulus=5e7, poissons_ratio=0.22)
LAW = SimpleNamespace(normal="any", pairs={})
UP = ((0, 0, 0), (0, 0, 1))


def one(position=(0, 0, 1), radius=0.1):
    return Spheres([position], radius, GLASS)


def scene(**parts):
    return Scene(**{"spheres": one(), "law": LAW, **parts})


def message(make, *args, **kwargs):
    with pytest.raises(InputError) as caught:
        make(*args, **kwargs)
    return str(caught.value).splitlines()


def test_material_names_all_that_is_wrong():
    assert message(Material, "gel", density=-1, youngs_modulus=0, poissons_ratio=0.6) == [
        "materials.gel.density = -1: must be > 0 kg/m3 (density)",
        "materials.gel.youngs_modulus = 0: must be > 0 Pa (Young's modulus)",
        "materials.gel.poissons_ratio = 0.6: must be > -1 and <= 0.5 (Poisson's ratio)",
    ]
    assert message(Material, "", 1, 1, 0) == ["material.name = : must be a name, not empty"]
    for wrong in ("a", True, math.nan, None):
        assert "density" in message(Material, "gel", wrong, 1, 0)[0]


@pytest.mark.parametrize("poissons_ratio", [-0.999, 0.0, 0.5])
def test_the_ends_of_a_range_are_as_declared(poissons_ratio):
    Material("ok", 1, 1, poissons_ratio)
    assert message(Material, "no", 1, 1, -1.0)


def test_spheres_are_read_only_contiguous_copies():
    position = np.arange(12.0).reshape(3, 4).T[1:]
    spheres = Spheres(position.astype(np.float32), [1, 2, 3], GLASS, velocity=(1, 2, 3))
    position[:] = 0
    np.testing.assert_array_equal(spheres.position[0], [1, 5, 9])
    np.testing.assert_array_equal(spheres.velocity, [[1, 2, 3]] * 3)
    np.testing.assert_array_equal(spheres.omega, np.zeros((3, 3)))
    for name in ("position", "radius", "velocity", "omega"):
        values = getattr(spheres, name)
        assert values.dtype == np.float64 and values.flags.c_contiguous
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 1
    assert spheres.count == 3
    np.testing.assert_allclose(spheres.mass, 2500 * 4 / 3 * np.pi * np.array([1, 8, 27]))


def test_materials_are_numbered_by_first_appearance():
    x = np.eye(3)
    listed = Spheres(x, 1, [GEL, GLASS, GEL])
    indexed = Spheres(x, 1, ((GLASS, GEL, GEL), [1, 0, 2]))
    for spheres in (listed, indexed):
        assert spheres.materials == (GEL, GLASS)
        np.testing.assert_array_equal(spheres.material_index, [0, 1, 0])
        assert spheres.material_index.dtype == np.int32
    assert listed == indexed
    assert listed != dataclasses.replace(listed, material=GEL)
    np.testing.assert_allclose(listed.mass[0] / listed.mass[1], 1050 / 2500)


def test_equality_sees_every_array():
    spheres = Spheres(np.eye(3), 1, GLASS)
    assert spheres == Spheres(np.eye(3), [1, 1, 1], [GLASS] * 3)
    for name in ("position", "radius", "velocity", "omega"):
        changed = getattr(spheres, name) + np.finfo(float).eps
        assert spheres != dataclasses.replace(spheres, **{name: changed})
    with pytest.raises(TypeError, match="unhashable"):
        hash(spheres)


def test_spheres_name_the_first_offenders_and_count_the_rest():
    assert message(Spheres, np.eye(3)[[0] * 20], [1] * 17 + [-0.01, 1, 1], GLASS) == [
        "spheres.radius[17] = -0.01: must be > 0 m (radius)"
    ]
    position = np.zeros((20, 3))
    position[5:, 1] = np.nan
    assert message(Spheres, position, 0, GLASS, omega=np.inf) == [
        *(
            f"spheres.position[{k}] = [0.0, nan, 0.0]: must be finite, in m (centre)"
            for k in (5, 6, 7)
        ),
        "spheres.position: and 12 more",
        "spheres.radius = 0: must be > 0 m (radius)",
        "spheres.omega: must be numbers of shape (20, 3), in rad/s; got shape ()",
    ]


@pytest.mark.parametrize(
    ("position", "what"),
    [
        ([], ": "),
        ([1, 2, 3], ": "),
        (np.ones((2, 2)), ": "),
        ([[1, 2]], "[0] = [1, 2]: must be 3 numbers; position "),
        ([[1, 2, 3], [3]], "[1] = [3]: must be 3 numbers; position "),
        ([1, [1, 2, 3]], "[0] = 1: must be 3 numbers; position "),
        ([["a"] * 3], "[0] = ['a', 'a', 'a']: must be 3 numbers; position "),
        ("text", ' = "text": '),
    ],
)
def test_positions_of_another_shape_are_refused(position, what):
    [line] = message(Spheres, position, 1, GLASS)
    if what[0] == "[":
        assert message(Spheres, position, -1, GLASS) == [
            line,
            "spheres.radius = -1: must be > 0 m (radius)",
        ]
    rule = "must be numbers of shape (n, 3), n >= 1, in m"
    assert line.startswith(f"spheres.position{what}{rule}")


def test_what_is_no_number_is_shown_as_it_was_given():
    at = [[0, 0, 0], [0, 0, 3]]
    assert message(Spheres, at, [1, "2"], GLASS, velocity=["a", 0, 0], omega="fast") == [
        'spheres.radius[1] = "2": must be a number; radius must be numbers of shape (2,), in m',
        'spheres.velocity[0] = "a": must be a number; velocity must be numbers of shape (2, 3), '
        "in m/s",
        'spheres.omega = "fast": must be numbers of shape (2, 3), in rad/s',
    ]
    assert message(Spheres, at, "1", GLASS) == [
        'spheres.radius = "1": must be numbers of shape (2,), in m'
    ]


@pytest.mark.parametrize(
    ("material", "rule"),
    [
        (None, "must be a Material, a sequence of n of them, or (materials, index of each)"),
        ("glass", "must be a Material"),
        ([GLASS], "must be one material for each of 2 spheres; got 1"),
        ([GLASS, "gel"], "must be a Material"),
        (([GLASS], [0, 1]), "index must be from 0 to 0"),
        (([GLASS], [0, -1]), "index must be from 0 to 0"),
        (([GLASS], [0.0, 0.0]), "index must be integers of shape (2,)"),
        (([GLASS], [0]), "index must be integers of shape (2,); got shape (1,)"),
    ],
)
def test_materials_of_spheres_are_checked(material, rule):
    [line] = message(Spheres, np.eye(3)[:2], 0.1, material)
    assert line.startswith("spheres.material: ") and rule in line


def test_faces_are_points_and_unit_normals_into_the_domain():
    box = Box((0, 0, -math.inf), (2, 3, 4), GLASS)
    found = [(point.tolist(), normal.tolist()) for point, normal in box.faces()]
    assert found == [
        ([0, 0, 0], [1, 0, 0]),
        ([2, 0, 0], [-1, 0, 0]),
        ([0, 0, 0], [0, 1, 0]),
        ([0, 3, 0], [0, -1, 0]),
        ([0, 0, 4], [0, 0, -1]),
    ]
    for kind in (Plane, Piston):
        motion = {"velocity": 1.0} if kind is Piston else {}
        [(point, normal)] = kind((1, 2, 3), (0, 3, -4), GLASS, **motion).faces()
        np.testing.assert_array_equal(point, [1, 2, 3])
        np.testing.assert_allclose(normal, [0, 0.6, -0.8], rtol=1e-15)
    assert [b.kind for b in (box, Plane(*UP, GLASS))] == ["Box", "Plane"]


@pytest.mark.parametrize(
    ("make", "lines"),
    [
        (
            lambda: Plane((0, 0, math.nan), (0, 0, 0), "glass", velocity=3),
            [
                "Plane.point = (0, 0, nan): must be three finite numbers",
                "Plane.velocity = 3: must be three finite numbers",
                "Plane.normal = (0.0, 0.0, 0.0): must not be the zero vector",
                "Plane.material = glass: must be a Material",
            ],
        ),
        (
            lambda: Box((0, 0, 1), (1, 1, 1), GLASS),
            ["Box.low = (0.0, 0.0, 1.0): must be below high = (1.0, 1.0, 1.0)"],
        ),
        (
            lambda: Box((-math.inf,) * 3, (math.inf,) * 3, GLASS),
            ["Box.low = (-inf, -inf, -inf): must leave at least one finite wall"],
        ),
        (
            lambda: Box((math.nan,) * 3, (0, 0), GLASS),
            [
                "Box.low = (nan, nan, nan): must be three numbers, not nan",
                "Box.high = (0, 0): must be three numbers",
            ],
        ),
        (
            lambda: Piston(*UP, GLASS),
            ["Piston.velocity: exactly one of velocity, program, load must be given; given: none"],
        ),
        (
            lambda: Piston(*UP, GLASS, velocity=1, load=math.inf),
            [
                "Piston.load = inf: must be finite, in N (along the normal)",
                "Piston.velocity: exactly one of velocity, program, load must be given; "
                "given: velocity and load",
                "Piston.mass: must be given with a load, in kg",
            ],
        ),
        (
            lambda: Piston(*UP, GLASS, velocity=1, mass=2),
            ["Piston.mass = 2: has no meaning without a load"],
        ),
        (
            lambda: Piston(*UP, GLASS, load=1, mass=0),
            ["Piston.mass = 0: must be > 0 kg (mass of the plate)"],
        ),
        (
            lambda: Piston(*UP, GLASS, program=[(0.1, 1), (0.3, 2), (0.3, 1)]),
            ["Piston.program[2] = [0.3, 1.0]: times must be >= 0 s and increase"],
        ),
        (
            lambda: Piston(*UP, GLASS, program=[(0, 1)]),
            ["Piston.program[0] = [0.0, 1.0]: must start at displacement 0 m"],
        ),
        (
            lambda: Piston(*UP, GLASS, program=[1, 2]),
            ["Piston.program = [1, 2]: must be (time, displacement) pairs, s and m"],
        ),
        (
            lambda: Substrate(
                GEL, tolerance=1, coupling="finit", exchange="laged", layer=1, relaxation=2
            ),
            [
                "substrate.tolerance = 1: must be > 0 and < 1 (of the displacement)",
                "substrate.coupling = finit: unknown choice; did you mean 'finite'? "
                "known: finite, point",
                "substrate.exchange = laged: unknown choice; did you mean 'lagged'? "
                "known: implicit, lagged, none",
                "substrate.layer = 1: must be a Layer or None",
                "substrate.relaxation = 2: must be a Relaxation or None",
            ],
        ),
        (
            lambda: Substrate(GEL, exchange="lagged", relaxation=Relaxation(3e4, 1.0)),
            [
                "substrate.relaxation.relaxed_modulus = 30000.0: must be <= 20000 Pa, the modulus "
                "of gel at once",
                "substrate.coupling = finite: must be 'point' with relaxation, which has no theory "
                "for contacts of finite size",
                "substrate.exchange = lagged: must be 'implicit' with relaxation, which is solved "
                "for as it passes",
            ],
        ),
        (
            lambda: Relaxation(0, -1),
            [
                "relaxation.relaxed_modulus = 0: must be > 0 Pa (Young's modulus at rest)",
                "relaxation.retardation_time = -1: must be > 0 s (time of creep under a constant "
                "load)",
            ],
        ),
        (
            lambda: Substrate(
                GEL, "x", "point", "none", layer=Layer(1), relaxation=Relaxation(1, 1)
            ),
            [
                'substrate.tolerance = "x": must be a number; must be > 0 and < 1 (of the '
                "displacement)",
                'substrate.layer: must be left out with exchange = "none", a plane',
                'substrate.relaxation: must be left out with exchange = "none", a plane',
            ],
        ),
        (
            lambda: Substrate(GEL, force_lagged="yes"),
            ["substrate.force_lagged = yes: must be true or false"],
        ),
    ],
)
def test_boundaries_and_substrate_refuse(make, lines):
    assert message(make) == lines


def test_only_hertz_contacts_stand_on_ground_that_creeps():
    ground = Substrate(GEL, coupling="point", relaxation=Relaxation(1e4, 1.0))
    [line] = message(scene, substrate=ground, law=SimpleNamespace(normal="any"))
    assert line.startswith("law.normal = any: must be Hertz with relaxation")
    law = SimpleNamespace(normal=SimpleNamespace(of_two_solids=True), pairs={})
    assert scene(substrate=ground, law=law).substrate is ground


def test_a_program_is_kept_as_pairs_of_floats():
    piston = Piston(*UP, GLASS, program=np.array([[0.3, 0.03], [0.6, 0]]))
    assert piston.program == ((0.3, 0.03), (0.6, 0.0))


def test_scene_gathers_the_materials_in_order_of_appearance():
    steel = Material("steel", 7800, 2e11, 0.3)
    made = scene(boundaries=[Plane(*UP, steel), Plane(*UP, GLASS)], substrate=Substrate(GEL))
    assert made.materials == (GLASS, steel, GEL)
    assert made.boundaries[0].material is steel
    assert made == scene(
        boundaries=(Plane(*UP, steel), Plane(*UP, GLASS)), substrate=Substrate(GEL)
    )
    assert made != scene(boundaries=made.boundaries)


def test_scene_refuses_what_is_of_the_wrong_kind():
    assert message(
        Scene, spheres=3, law=None, boundaries=[4], substrate=5, period=(1, 0), gravity=9.81
    ) == [
        "spheres = 3: must be Spheres",
        "boundaries[0] = 4: must be a Plane, Box or Piston",
        "substrate = 5: must be a Substrate or None",
        "law: must be a Law",
        "gravity = 9.81: must be three finite numbers",
        "period = (1, 0): must be two finite lengths > 0 m, [Lx, Ly], or left out",
    ]
    assert message(scene, boundaries=3) == ["boundaries = 3: must be a list of boundaries"]


def test_scene_refuses_one_name_for_two_materials_and_pairs_of_unknown_ones():
    other = dataclasses.replace(GLASS, density=2600)
    law = SimpleNamespace(normal="any", pairs={("glass", "glas"): {}})
    assert message(scene, law=law, boundaries=[Plane(*UP, other)]) == [
        "materials.glass: the name stands for two different materials",
        "law.pairs = ['glass', 'glas']: unknown material; did you mean 'glass'? known: glass",
    ]


def test_centres_must_be_inside_and_above():
    spheres = Spheres([[0.5, 0.5, 1], [0.5, 0.5, 0], [2, 0.5, -1]], 0.1, GLASS)
    box = Box((0, 0, -math.inf), (1, 1, 9), GLASS)
    assert message(scene, spheres=spheres, boundaries=[box], substrate=Substrate(GEL)) == [
        "spheres.position[2] = [2.0, 0.5, -1.0]: the centre must be inside boundaries[0]; "
        "it is 1 m beyond",
        "spheres.position[1] = [0.5, 0.5, 0.0]: the centre must be above the substrate; "
        "it is 0 m beyond",
        "spheres.position[2] = [2.0, 0.5, -1.0]: the centre must be above the substrate; "
        "it is 1 m beyond",
    ]
    scene(spheres=one((0, 0, 0.01)), substrate=Substrate(GEL))


@pytest.mark.parametrize("scale", [1e-8, 1.0, 1e3])
def test_overlap_of_half_the_smaller_radius_is_the_limit_at_any_scale(scale):
    def pair(overlap):
        x = np.array([[0, 0, 1], [0, 0, 1 + 0.3 - overlap]])
        return Spheres(scale * x, scale * np.array([0.2, 0.1]), GLASS)

    scene(spheres=pair(0.0499))
    [line] = message(scene, spheres=pair(0.0501))
    assert "overlaps sphere 0 by" in line and "is accepted" in line
    assert line.startswith("spheres.position[1]")


def test_coincident_spheres_are_told_apart_from_overlapping_ones():
    spheres = Spheres([[0, 0, 1], [5, 0, 1], [0, 0, 1]], [1, 1, 0.01], GLASS)
    assert message(scene, spheres=spheres) == [
        "spheres.position[2] = [0.0, 0.0, 1.0]: has the same centre as sphere 0"
    ]


def test_a_packing_in_wrong_units_is_refused_without_listing_every_pair():
    x = np.random.default_rng(0).uniform(1, 2, (20000, 3))
    lines = message(scene, spheres=Spheres(x, 10.0, GLASS))
    assert len(lines) == 4 and lines[-1].startswith("spheres.position: and ")
    assert len(message(scene, spheres=Spheres(np.ones((20000, 3)), 10.0, GLASS))) == 4


@pytest.mark.parametrize(
    "period", [0, (1,), (1, 2, 3), (1, -1), (math.inf, 1), (1, math.nan), "xy"]
)
def test_a_period_is_two_lengths(period):
    [line] = message(scene, period=period)
    assert line.startswith("period = ") and line.endswith(
        "must be two finite lengths > 0 m, [Lx, Ly], or left out"
    )


def test_periodic_sides_leave_room_and_have_no_walls():
    walls = [
        Plane((0, 0, 0), (0.1, 0, 1), GLASS),
        Plane((0, 0, 0), (0, 0, 3), GLASS, velocity=(1, 0, 0)),
        Box((-1, -math.inf, 0), (math.inf, 2, 2), GLASS),
        Piston((0, 9, 0), (0, -1, 0), GLASS, velocity=1),
    ]
    rule = "the sides are periodic along x and y"
    assert message(scene, spheres=one((0, 0.5, 1)), boundaries=walls, period=(0.4, 0.3)) == [
        "period = (0.4, 0.3): must be at least 0.4 m, four times the largest radius: else a sphere "
        "could touch two images of another",
        f"boundaries[0].normal = (0.1, 0.0, 1.0): must be along z: {rule}",
        f"boundaries[2].low = (-1.0, -inf, 0.0): must be -inf along x and y: {rule}",
        f"boundaries[2].high = (inf, 2.0, 2.0): must be inf along x and y: {rule}",
        f"boundaries[3].normal = (0.0, -1.0, 0.0): must be along z: {rule}",
    ]
    made = scene(spheres=one((70, -8, 1)), boundaries=walls[1:2], period=[np.float32(1), 2])
    assert made.period == (1.0, 2.0)


def test_overlaps_over_periodic_sides_are_seen():
    spheres = Spheres([[0.05, 0.1, 1], [0.93, -0.85, 1]], 0.1, GLASS)
    scene(spheres=spheres)
    assert spheres.overlapping() is spheres.overlapping()  # for the time step, without a search
    scene(spheres=spheres, period=(1.0, 1.1))
    [line] = message(scene, spheres=spheres, period=(1.0, 1.0))
    assert line.startswith("spheres.position[1] = [0.93, -0.85, 1.0]: overlaps sphere 0 by 0.07 m")
    [line] = message(scene, spheres=spheres, period=(0.1, 1.0))  # in which all would overlap
    assert line.startswith("period = (0.1, 1.0): must be at least 0.4 m")
