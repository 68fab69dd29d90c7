"""Packings: generated ones hold what was asked; files give what they say or name the line."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from taichi_dem import overlaps
from taichi_dem.scene import Material, Spheres
from taichi_dem.validation import InputError

BEAD = Material("bead", density=11.5, youngs_modulus=23.3e3, poissons_ratio=0.5)
GLASS = Material("glass", density=2500, youngs_modulus=5e7, poissons_ratio=0.22)
UNIT = ((0, 0, 0), (1, 1, 1))
HYDROGEL = Path(__file__).parents[3] / "shared/reference/hydrogel/particles.data"


def message(make, *args, **kwargs):
    with pytest.raises(InputError) as caught:
        make(*args, **kwargs)
    return str(caught.value).splitlines()


def all_pairs(position, radius):
    i, j = np.triu_indices(len(position), k=1)
    return i, j, radius[i] + radius[j] - np.linalg.norm(position[i] - position[j], axis=1)


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.floats(1, 20), st.floats(0.01, 0.3))
def test_overlapping_finds_each_pair_once(seed, ratio, typical):
    rng = np.random.default_rng(seed)
    radius = typical * ratio ** rng.uniform(-1, 0, 200)
    position = rng.uniform(0, 1, (200, 3))
    i, j, overlap = all_pairs(position, radius)
    expected = set(zip(i[overlap > 0], j[overlap > 0], strict=True))
    *pairs, depths = overlaps.overlapping(position, radius)
    found = [tuple(sorted(pair)) for pair in zip(*pairs, strict=True)]
    assert len(found) == len(expected) and set(found) == expected
    assert np.allclose(np.sort(depths), np.sort(overlap[overlap > 0]))


def test_deep_overlaps_finds_a_pair_that_is_not_of_nearest_neighbours():
    """The large sphere sits deep in the middle one, whose nearest neighbour is a small one."""
    position = np.array([[0.0, 0, 0], [2.4, 0, 0], [0, 1.3, 0]])
    radius = np.array([1.0, 1.99, 0.2])
    i, j, overlap = overlaps.deep_overlaps(position, radius, 0.5)
    assert (i.tolist(), j.tolist()) == ([0], [1])
    np.testing.assert_allclose(overlap, 0.59)


def test_deep_overlaps_of_a_single_sphere():
    assert len(overlaps.deep_overlaps(np.zeros((1, 3)), np.ones(1), 0.5)[0]) == 0


@pytest.mark.parametrize(
    ("radius", "fraction"),
    [
        (0.03, 0.1),
        (0.03, 0.3),
        (0.04, 0.55),
        (("uniform", 0.02, 0.06), 0.5),
        (("lognormal", 0.02, 0.6, 0.01, 0.15), 0.5),
    ],
)
def test_generated_spheres_fill_the_region_without_overlap(radius, fraction):
    low, high = np.array([-1, 2, 0]), np.array([0, 3, 1.5])
    made = Spheres.generate(
        GLASS, radius=radius, region=(low, high), volume_fraction=fraction, seed=4
    )
    assert len(overlaps.deep_overlaps(made.position, made.radius, 0.0)[0]) == 0
    assert (made.position - made.radius[:, None] >= low).all()
    assert (made.position + made.radius[:, None] <= high).all()
    volumes = 4 / 3 * np.pi * made.radius**3
    assert abs(volumes.sum() - fraction * 1.5) <= volumes.max() / 2 + 1e-12


@pytest.mark.parametrize("fraction", [0.1, 0.55])
def test_periodic_packings_go_over_the_sides(fraction):
    """No sphere overlaps an image of another, and centres are as near the sides as anywhere."""
    low, high = np.array([-1, 2, 0]), np.array([0, 3.2, 1])
    made = Spheres.generate(
        GLASS,
        radius=("uniform", 0.02, 0.06),
        region=(low, high),
        volume_fraction=fraction,
        seed=4,
        periodic=True,
    )
    x, period = made.position, (1.0, 1.2)
    assert len(overlaps.deep_overlaps(x, made.radius, 0.0, period)[0]) == 0
    assert len(overlaps.overlapping(x, 1.2 * made.radius, period)[0]) > len(
        overlaps.overlapping(x, 1.2 * made.radius)[0]
    )
    assert ((x >= low) & (x < high))[:, :2].all()
    assert (x[:, 2] >= made.radius).all() and (x[:, 2] <= 1 - made.radius).all()
    shares = ((x - low) / (high - low))[:, :2]
    for axis in range(2):
        assert stats.kstest(shares[:, axis], "uniform").pvalue > 0.01


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.floats(1, 20), st.floats(0.01, 0.2))
def test_overlapping_images_are_found(seed, ratio, typical):
    """As among all spheres and their images in the cells around."""
    rng = np.random.default_rng(seed)
    radius = typical * ratio ** rng.uniform(-1, 0, 80)
    period = (1.0, 0.9)
    position = rng.uniform(-2, 3, (80, 3)) * [1, 1, 0.3]
    inside = np.mod(position[:, :2], period)
    expected = set()
    for shift in np.ndindex(3, 3):
        apart = position[:, None] - position
        apart[..., :2] = inside[:, None] - inside + (np.array(shift) - 1) * period
        close = np.linalg.norm(apart, axis=-1) < radius[:, None] + radius
        expected |= set(zip(*np.nonzero(np.triu(close, k=1)), strict=True))
    pairs = zip(*overlaps.overlapping(position, radius, period)[:2], strict=True)
    found = [tuple(sorted(pair)) for pair in pairs]
    assert len(found) == len(set(found)) and set(found) == expected


def test_equal_arguments_give_equal_packings():
    def made(seed):
        return Spheres.generate(
            GLASS, radius=("normal", 0.05, 0.01, 0.02, 0.1), region=UNIT, count=300, seed=seed
        )

    assert made(7) == made(7)
    assert made(7) != made(8)
    assert made(7).count == 300


@pytest.mark.parametrize(
    ("radius", "law"),
    [
        (("uniform", 1e-3, 3e-3), stats.uniform(1e-3, 2e-3)),
        (("normal", 2e-3, 1e-3, 1e-3, 4e-3), stats.truncnorm(-1, 2, 2e-3, 1e-3)),
    ],
)
def test_radii_follow_the_distribution(radius, law):
    made = Spheres.generate(GLASS, radius=radius, region=UNIT, count=5000)
    assert stats.kstest(made.radius, law.cdf).pvalue > 0.01


def test_lognormal_radii_are_normal_in_the_logarithm_and_cut_off():
    radius = ("lognormal", 2e-3, 0.5, 1e-3, 8e-3)
    made = Spheres.generate(GLASS, radius=radius, region=UNIT, count=5000).radius
    assert made.min() >= 1e-3 and made.max() <= 8e-3
    ends = np.log([0.5, 4]) / 0.5
    law = stats.truncnorm(*ends, np.log(2e-3), 0.5)
    assert stats.kstest(np.log(made), law.cdf).pvalue > 0.01


def test_dilute_centres_are_uniform():
    made = Spheres.generate(GLASS, radius=0.01, region=UNIT, count=4000)
    for axis in range(3):
        uniform = stats.uniform(0.01001, 0.97998)
        assert stats.kstest(made.position[:, axis], uniform.cdf).pvalue > 0.01


def test_a_single_radius_is_kept_exactly():
    made = Spheres.generate(GLASS, radius=0.1, region=UNIT, count=20, velocity=(0, 0, -1))
    assert (made.radius == 0.1).all() and (made.velocity == [0, 0, -1]).all()


@pytest.mark.parametrize(
    ("wrong", "line"),
    [
        ({"radius": -1}, "radius = -1: must be > 0 m (radius)"),
        ({"radius": "big"}, 'radius = "big": must be a number; must be > 0 m (radius)'),
        (
            {"radius": ("unifrm", 1, 2)},
            "radius[0] = unifrm: unknown distribution; did you mean 'uniform'? "
            "known: uniform, normal, lognormal",
        ),
        ({"radius": ("uniform", 1)}, "radius = ('uniform', 1): must be ('uniform', low, high)"),
        ({"radius": ("uniform", 0, 1)}, "radius[1] = 0: must be > 0 m (low)"),
        (
            {"radius": ("uniform", 2, 1)},
            "radius = ('uniform', 2, 1): must have low from low to high",
        ),
        (
            {"radius": ("normal", 5, 1, 1, 2)},
            "radius = ('normal', 5, 1, 1, 2): must have mean from low to high",
        ),
        ({"count": 0}, "count = 0: must be a whole number >= 1"),
        ({"count": 1.5}, "count = 1.5: must be a whole number >= 1"),
        ({"count": None}, "count: exactly one of count and volume_fraction must be given"),
        (
            {"volume_fraction": 0.1},
            "count = 3: exactly one of count and volume_fraction must be given",
        ),
        (
            {"count": None, "volume_fraction": 0.7},
            "volume_fraction = 0.7: must be > 0 and <= 0.58 (share of the region)",
        ),
        ({"seed": -1}, "seed = -1: must be a whole number >= 0"),
        ({"region": (0, 1)}, "region = (0, 1): must be two corners of three finite numbers, in m"),
        (
            {"region": ((0, 0, 0), (1, 0, 1))},
            "region = ((0, 0, 0), (1, 0, 1)): "
            "the first corner must be below the second on each axis",
        ),
        (
            {"radius": 0.6},
            "region = ((0, 0, 0), (1, 1, 1)): "
            "must be wider than the largest sphere, 1.201 m with clearance",
        ),
        (
            {"count": None, "volume_fraction": 1e-4},
            "volume_fraction = 0.0001: is less than one sphere in this region",
        ),
        (
            {"count": 200},
            "count = 200: fills 0.8378 of the region; at most 0.58 is reachable, about 138 spheres",
        ),
    ],
)
def test_generate_says_what_would_be_right(wrong, line):
    asked = {"radius": 0.1, "region": UNIT, "count": 3, **wrong}
    assert message(Spheres.generate, GLASS, **asked) == [f"spheres.generate.{line}"]


def test_generate_says_what_was_reached_where_it_fails():
    """Four spheres of radius 0.3 do not fit a unit box; the largest four that do have 0.2929."""
    [line] = message(Spheres.generate, GLASS, radius=0.3, region=UNIT, count=4)
    assert "fills 0.4524 of the region, which was not reached; with radii 0." in line
    factor = float(line.split("radii ")[1].split()[0])
    assert factor * 0.3 <= 1 / (2 + np.sqrt(2))


def test_hydrogel_packing():
    if not HYDROGEL.exists():
        pytest.skip("the measured packing ../shared/reference/hydrogel is not here")
    beads = Spheres.from_lammps_data(HYDROGEL, {1: BEAD})
    assert beads.count == 514 and beads.materials == (BEAD,)
    np.testing.assert_array_equal(beads.position[0], [0.0281955, 0.15621, 0.0747432])
    assert beads.radius[0] == 0.0192777 / 2
    np.testing.assert_array_equal(beads.velocity[513], [-4.905e-06, -9.81703e-05, -2.39189e-4])
    np.testing.assert_allclose(beads.mass[0], 11.5 * np.pi / 6 * 0.0192777**3)
    assert len(overlaps.deep_overlaps(beads.position, beads.radius, 0.06)[0]) == 0
    [line] = message(Spheres.from_lammps_data, HYDROGEL, GLASS)
    assert line.endswith(
        "atoms of type 1 have density 11.5 kg/m3 in the file, and their material 'glass' 2500; "
        "make them equal"
    )


DATA = """LAMMPS data file

 2 atoms
 2 atom types
 0 1 xlo xhi

Atoms # sphere

7 2 0.2 2500 1 2 3   # a comment
5 1 0.1 11.5 4 5 6 0 0 1
"""


def test_lammps_atoms_are_sorted_by_id_with_velocities_joined(tmp_path):
    path = tmp_path / "in.data"
    path.write_text(DATA + "\nVelocities\n\n7 1 2 3 4 5 6\n5 0 0 0 0 0 9\n")
    made = Spheres.from_lammps_data(path, [BEAD, GLASS])
    np.testing.assert_array_equal(made.position, [[4, 5, 6], [1, 2, 3]])
    np.testing.assert_array_equal(made.radius, [0.05, 0.1])
    np.testing.assert_array_equal(made.velocity, [[0, 0, 0], [1, 2, 3]])
    np.testing.assert_array_equal(made.omega, [[0, 0, 9], [4, 5, 6]])
    assert made.materials == (BEAD, GLASS)


@pytest.mark.parametrize(
    ("old", "new", "where", "rule"),
    [
        ("1 2 3 ", "1 2 x ", ":9", "must be 7 numbers: id type diameter density x y z; found '7 2"),
        ("1 2 3 ", "1 2 ", ":9", "must be 7 numbers"),
        ("sphere", "bond", ":7", "atom style 'bond' is not known; must be sphere"),
        ("Atoms #", "Bodies #", "", "has no section 'Atoms'"),
        ("2 atoms", "3 atoms", "", "promises 3 atoms and has 2"),
        ("7 2", "5 2", "", "has two atoms with id 5"),
        ("\n7", "\nVelocities\n\n7", "", "has no spheres"),
        ("sphere\n", "sphere\n\nVelocities\n\n1 0 0 0 0 0 0\n\nAtoms\n", "", "the ids of 'Veloc"),
        ("7 2", "7 3", "", "has atoms of type 3; materials are given for [1, 2]"),
    ],
)
def test_lammps_mistakes_name_file_and_line(tmp_path, old, new, where, rule):
    path = tmp_path / "in.data"
    path.write_text(DATA.replace(old, new))
    [line] = message(Spheres.from_lammps_data, path, [BEAD, GLASS])
    assert f"in.data{where}: " in line and rule in line


def test_missing_files_are_named(tmp_path):
    for read, name in (
        (lambda p: Spheres.from_lammps_data(p, BEAD), "a.data"),
        (lambda p: Spheres.from_csv(p, BEAD), "a.csv"),
        (lambda p: Spheres.from_npz(p, BEAD), "a.npz"),
    ):
        [line] = message(read, tmp_path / name)
        assert line.endswith(f"{name}: there is no such file")


def test_csv_with_everything(tmp_path):
    path = tmp_path / "in.csv"
    path.write_text(
        "radius, x, y, z, material, vx, vy, vz, wx, wy, wz\n"
        "0.5, 1, 2, 3, glass, 4, 5, 6, 7, 8, 9\n\n"
        "1e-1, 0.1, 0.2, 0.3, bead, 0, 0, 0, 0, 0, 0\n"
    )
    made = Spheres.from_csv(path, [BEAD, GLASS])
    assert made == Spheres(
        [[1, 2, 3], [0.1, 0.2, 0.3]],
        [0.5, 0.1],
        [GLASS, BEAD],
        velocity=[[4, 5, 6], [0, 0, 0]],
        omega=[[7, 8, 9], [0, 0, 0]],
    )


@pytest.mark.parametrize(
    ("text", "where", "rule"),
    [
        ("x,y,z,radiu\n", ":1", "unknown column 'radiu'; did you mean 'radius'?"),
        ("x,y,z\n1,2,3\n", ":1", "column 'radius' is missing"),
        ("x,y,radius\n1,2,3\n", ":1", "column 'z' is missing"),
        ("x,y,z,radius,vx,vy\n", ":1", "column 'vz' is missing"),
        ("x,y,z,radius,x\n", ":1", "has the column 'x' twice"),
        ("x,y,z,radius\n1,2,3,4\n1,2,3\n", ":3", "must have 4 columns: x, y, z, radius; has 3"),
        ("x,y,z,radius\n1,2,3,a\n", ":2", "must be 4 numbers: x y z radius; found '1 2 3 a'"),
        ("x,y,z,radius\n", "", "has no spheres"),
    ],
)
def test_csv_mistakes_name_file_and_line(tmp_path, text, where, rule):
    path = tmp_path / "in.csv"
    path.write_text(text)
    [line] = message(Spheres.from_csv, path, GLASS)
    assert f"in.csv{where}: " in line and rule in line


def test_materials_of_tables_are_looked_up_by_name(tmp_path):
    path = tmp_path / "in.csv"
    path.write_text("x,y,z,radius,material\n1,2,3,1,glas\n")
    [line] = message(Spheres.from_csv, path, [GLASS, BEAD])
    assert "unknown material" in line and "did you mean 'glass'?" in line
    path.write_text("x,y,z,radius\n1,2,3,1\n")
    [line] = message(Spheres.from_csv, path)
    assert line.endswith("names no materials: give one for all spheres")


def test_npz_round_trip_is_exact(tmp_path):
    rng = np.random.default_rng(1)
    made = Spheres(
        rng.normal(size=(50, 3)),
        rng.uniform(0.1, 1, 50),
        ((BEAD, GLASS), rng.integers(0, 2, 50)),
        velocity=rng.normal(size=(50, 3)),
        omega=rng.normal(size=(50, 3)),
    )
    made.to_npz(tmp_path / "a.npz")
    assert Spheres.from_npz(tmp_path / "a.npz", [GLASS, BEAD]) == made


def test_npz_mistakes(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, position=np.eye(3))
    assert "array 'radius' is missing" in message(Spheres.from_npz, path, GLASS)[0]
    np.savez(path, position=np.eye(3), radius=np.ones(3), veloctiy=np.eye(3))
    assert "did you mean 'velocity'?" in message(Spheres.from_npz, path, GLASS)[0]
    path.write_text(json.dumps("not an archive"))
    assert "must be an .npz archive" in message(Spheres.from_npz, path, GLASS)[0]
