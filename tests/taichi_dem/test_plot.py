"""Pictures show what the run has: places, sizes, units, numbers."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from fake_simulation import FakeSimulation, box, layer, plane

from taichi_dem.snapshot import Snapshot

pytest.importorskip("matplotlib")

from matplotlib.collections import EllipseCollection

from taichi_dem import plot, style
from taichi_dem.bed import visible
from taichi_dem.output import History, State


@pytest.fixture
def sim():
    piston = plane((0, 0, 4e-3), (0, 0, -1), "Piston")
    walls = [box((-2e-3, -2e-3, -np.inf), (8e-3, 8e-3, np.inf)), piston]
    return FakeSimulation(*layer(16), boundaries=walls)


def record(sim, folder, rows=5):
    """A run that presses its piston by 10 µm a row against 1 N/mm."""
    outputs = [History(folder, every=1e-5), State(folder, every=1e-5, substrate_points=17)]
    for output in outputs:
        output.start(sim)
    for k in range(rows):
        sim.boundaries[1].position[2] = 4e-3 - k * 1e-5
        sim.boundaries[1].force[2] = k * 1e-2
        for output in outputs:
            output.write(sim)
        sim.advance()
    return folder


def circles(figure):
    (found,) = (c for c in figure.axes[0].collections if isinstance(c, EllipseCollection))
    return found


# Units


@pytest.mark.parametrize(
    ("values", "unit", "expected"),
    [
        ([2e-5, 1e-6], "m", (1e6, "µm")),
        ([1e-3], "m", (1e3, "mm")),
        ([-0.5], "N", (1e3, "mN")),
        ([999.0], "J", (1.0, "J")),
        ([1e3, np.nan, np.inf], "J", (1e-3, "kJ")),
        ([0.0], "m", (1.0, "m")),
        ([], "m", (1.0, "m")),
        ([1e-15], "N", (1e12, "pN")),
    ],
)
def test_units_leave_one_to_three_digits(values, unit, expected):
    factor, name = style.scale_of(values, unit)
    assert (pytest.approx(factor), name) == expected


# Depression


def test_depression_shows_the_field_in_its_place(sim):
    state = Snapshot.of(sim, substrate_points=33)
    axes = plot.depression(state).axes[0]
    (image,) = axes.images
    np.testing.assert_allclose(image.get_array(), state.depression * 1e6)
    half = 0.5 * (state.grid_x[1] - state.grid_x[0])
    assert image.get_extent()[:2] == pytest.approx(
        [(state.grid_x[0] - half) * 1e3, (state.grid_x[-1] + half) * 1e3]
    )
    assert image.origin == "lower"
    assert axes.get_aspect() == 1
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x (mm)", "y (mm)")


def test_depression_shows_contacts_at_their_size_and_force(sim):
    state = Snapshot.of(sim, substrate_points=33)
    figure = plot.depression(state)
    drawn = circles(figure)
    order = np.argsort(state.substrate_force)
    np.testing.assert_allclose(drawn.get_offsets(), state.substrate_position[order] * 1e3)
    np.testing.assert_allclose(drawn.get_widths(), 2e3 * state.substrate_radius[order])
    np.testing.assert_allclose(drawn.get_array(), state.substrate_force[order] * 1e6)
    assert [axes.get_ylabel() for axes in figure.axes[1:]] == [
        "depression (µm)",
        "normal force (µN)",
    ]


def test_raised_ground_has_colours_of_its_own(sim):
    state = Snapshot.of(sim)
    plain = plot.depression(state).axes[0].images[0]
    assert plain.norm.vmin == 0 and plain.get_clim()[1] > 0
    raised = state.depression - state.depression.mean()
    drawing = plot.depression(dataclasses.replace(state, depression=raised))
    image = drawing.axes[0].images[0]
    low, high = image.get_clim()
    assert low < 0 < high and low / high == pytest.approx(raised.min() / raised.max())
    ticks = drawing.axes[1].get_yticks()
    assert ticks.min() < 0 < ticks.max()


@pytest.mark.parametrize("raised", [5.0, 300.0, 700.0, 2000.0])
def test_raised_ground_is_as_strongly_coloured_as_dents_of_that_size(raised):
    """By how far the colours are from white, within what two different hues allow."""
    deepest = 700.0
    colors, norm = style.depths(np.array([deepest, 0.0, -raised]))
    assert norm(0.5 * (deepest - raised)) == pytest.approx(0.5)  # one linear scale

    def strength(depth):
        return 1 - np.mean(colors(norm(depth))[:3])

    assert strength(0.0) < 0.01
    for size in np.linspace(0.2, 1.0, 5) * min(raised, deepest):
        assert strength(-size) == pytest.approx(strength(size), rel=0.4, abs=0.01)
    assert strength(deepest) > 0.99 * strength(0.5 * deepest)
    most = max(raised, deepest)
    full = strength(deepest if deepest == most else -raised)
    assert strength(-raised) == pytest.approx(full * raised / most, rel=0.4, abs=0.01)


def test_contacts_over_the_edge_of_a_periodic_cell_are_drawn_on_both_sides(sim):
    state = Snapshot.of(sim)
    one = [0]
    state = dataclasses.replace(
        state,
        period=np.array([8e-3, 9e-3]),
        substrate_position=np.array([[0.01e-3, 8.95e-3]]),
        substrate_force=state.substrate_force[one],
        substrate_radius=np.array([0.1e-3]),
    )
    places = circles(plot.depression(state)).get_offsets() / 1e3
    expected = [[x, y] for x in (0.01e-3, 8.01e-3) for y in (-0.05e-3, 8.95e-3)]
    assert np.allclose(sorted(places.tolist()), expected)


def test_depression_before_anything_touches(tmp_path):
    sim = FakeSimulation([[0, 0, 5e-3]], [1e-3])
    figure = plot.depression(sim)
    assert not figure.axes[0].images[0].get_array().any()
    style.save(figure, tmp_path / "depression.png")


def test_depression_needs_a_substrate():
    with pytest.raises(ValueError, match="no substrate"):
        plot.depression(FakeSimulation(*layer(4), substrate=False))


# Bed


def test_bed_shows_the_spheres_in_true_proportion(sim):
    figure = plot.bed(sim)
    drawn, state = circles(figure), Snapshot.of(sim)
    steps = len(drawn.get_widths()) // 16
    far_first = np.argsort(-state.position[:, 1], kind="stable")
    offsets = drawn.get_offsets()[::steps]
    np.testing.assert_allclose(offsets, state.position[far_first][:, [0, 2]] * 1e3)
    np.testing.assert_allclose(drawn.get_widths()[::steps], 2e3 * state.radius[far_first])
    axes = figure.axes[0]
    assert axes.get_aspect() == 1
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x (mm)", "z (mm)")
    left, right, bottom, top = *axes.get_xlim(), *axes.get_ylim()
    assert left < -2 and right > 8 and bottom < 0 and top > 4  # walls, ground and piston


def test_highlights_stay_inside_their_spheres(sim):
    drawn = circles(plot.bed(sim))
    steps = len(drawn.get_widths()) // 16
    size = np.reshape(drawn.get_widths(), (16, steps))
    center = np.reshape(drawn.get_offsets(), (16, steps, 2))
    shift = np.linalg.norm(center - center[:, :1], axis=-1)
    assert np.all(shift + 0.5 * size <= 0.5 * size[:, :1] * (1 + 1e-12))


def test_bed_is_coloured_by_force_speed_or_material(sim):
    force = plot.bed(sim)
    assert force.axes[1].get_ylabel() == "sum of normal forces (mN)"
    state = Snapshot.of(sim)
    pressed = np.zeros(len(state.radius))
    for i, j, push in zip(state.contact_i, state.contact_j, state.normal_force, strict=True):
        pressed[i] += push
        if j >= 0:
            pressed[j] += push
    assert force.axes[1].get_ylim() == pytest.approx((0, pressed.max() * 1e3))
    speed = plot.bed(sim, color="speed")
    fastest = np.linalg.norm(sim.particles.velocity, axis=1).max()
    assert speed.axes[1].get_ylabel() == "speed (mm/s)"
    assert speed.axes[1].get_ylim() == pytest.approx((0, fastest * 1e3))
    sim.particles.material[:3] = 2
    material = plot.bed(sim)
    names = [text.get_text() for text in material.axes[0].get_legend().get_texts()]
    assert names == ["glass", "steel"]
    with pytest.raises(ValueError, match="color = 'size'"):
        plot.bed(sim, color="size")


def test_bed_that_falls_is_coloured_by_speed():
    figure = plot.bed(FakeSimulation([[0, 0, 5e-3]], [1e-3]))
    assert figure.axes[1].get_ylabel() == "speed (mm/s)"


def test_overview_shows_bed_and_dents_to_one_scale(sim):
    figure = plot.overview(sim)
    side, above = figure.axes[:2]
    assert (side.get_ylabel(), above.get_ylabel()) == ("z (mm)", "y (mm)")
    assert side.get_xlim() == above.get_xlim()
    assert style.points(side) == pytest.approx(style.points(above))
    assert side.get_position().x0 == pytest.approx(above.get_position().x0)
    assert side.get_position().y0 > above.get_position().y1
    with pytest.raises(ValueError, match="no substrate"):
        plot.overview(FakeSimulation(*layer(4), substrate=False))


def test_walls_end_where_they_meet_each_other(sim):
    lines = [np.array(line.get_xydata()) for line in plot.bed(sim).axes[0].lines]
    piston = next(line for line in lines if line.shape == (2, 2) and np.allclose(line[:, 1], 4))
    np.testing.assert_allclose(np.sort(piston[:, 0]), [-2, 8])
    side = next(line for line in lines if line.shape == (2, 2) and np.allclose(line[:, 0], -2))
    np.testing.assert_allclose(np.sort(side[:, 1]), [0, 4], atol=1e-12)


def test_walls_far_away_do_not_shrink_the_bed():
    sim = FakeSimulation(*layer(16), boundaries=[plane((0, 0, 5.0), (0, 0, -1))])
    assert plot.bed(sim).axes[0].get_ylim()[1] < 10


def test_a_crowd_shows_its_front_only():
    k = np.arange(50_000)
    x = np.column_stack([k % 20, k // 400, k // 20 % 20]) * 2e-3
    state = Snapshot.of(FakeSimulation(np.zeros((1, 3)), [1e-3], substrate=False))
    state = type(state)(**{**vars(state), "position": x, "radius": np.full(len(k), 1e-3)})
    shown = visible(state)
    assert len(shown) == 20 * 20 * 8
    assert np.all(x[shown, 1] <= 7 * 2e-3)
    assert np.all(np.diff(x[shown, 1]) <= 0)


def test_pictures_of_a_run_that_blew_up(tmp_path):
    state = Snapshot.of(FakeSimulation(*layer(16)))
    position, velocity = state.position.copy(), state.velocity.copy()
    position[3], velocity[5] = np.nan, np.inf
    broken = {
        "position": position,
        "velocity": velocity,
        "depression": np.full_like(state.depression, np.nan),
        "substrate_force": np.full_like(state.substrate_force, np.nan),
        "substrate_radius": np.full_like(state.substrate_radius, np.nan),
    }
    state = type(state)(**{**vars(state), **broken})
    for name, picture in (("bed", plot.bed), ("depression", plot.depression)):
        assert style.save(picture(state), tmp_path / f"{name}.png").stat().st_size > 0


@pytest.mark.parametrize("count", [0, 1])
def test_bed_of_few_spheres(count, tmp_path):
    sim = FakeSimulation(np.full((count, 3), 5e-3), np.full(count, 1e-3), substrate=False)
    style.save(plot.bed(sim), tmp_path / "bed.png")


# History


def test_energy_shows_each_part_and_the_balance(sim, tmp_path):
    figure = plot.energy(record(sim, tmp_path))
    parts, balance = figure.axes
    assert [line.get_label() for line in parts.lines] == ["kinetic", "gravity"]
    kinetic = sim.energy()["kinetic"]
    factor, unit = style.scale_of([kinetic, sim.energy()["gravity"]], "J")
    assert parts.get_ylabel() == f"energy ({unit})"
    np.testing.assert_allclose(parts.lines[0].get_ydata(), kinetic * factor)
    np.testing.assert_allclose(parts.lines[0].get_xdata(), np.arange(5) * 10)
    assert balance.get_xlabel() == "time (µs)"
    assert balance.get_ylabel().startswith("balance\nerror")


def test_energy_without_a_balance():
    history = {"time_s": np.arange(3.0), "kinetic_J": np.arange(3.0), "normal_J": np.zeros(3)}
    (axes,) = plot.energy(history).axes
    assert [line.get_label() for line in axes.lines] == ["kinetic"]


def test_stroke_is_along_the_motion_and_positive_against_it(sim, tmp_path):
    history = plot.read_history(record(sim, tmp_path))
    assert plot.pistons(history) == [1]
    displacement, force = plot.stroke(history, 1)
    np.testing.assert_allclose(displacement, np.arange(5) * 1e-5, atol=1e-15)
    np.testing.assert_allclose(force, np.arange(5) * 1e-2)


def test_stroke_of_an_inclined_piston():
    along = np.array([0.6, 0.0, -0.8])
    travel = np.array([0.0, 1.0, 3.0, 2.0])
    history = {f"boundary0_{k}_m": 7 + travel * along[i] for i, k in enumerate("xyz")}
    history |= {f"boundary0_f{k}_N": -5 * travel * along[i] for i, k in enumerate("xyz")}
    displacement, force = plot.stroke(history, 0)
    np.testing.assert_allclose(displacement, travel, atol=1e-14)
    np.testing.assert_allclose(force, 5 * travel, atol=1e-13)


def test_stroke_of_a_piston_that_stands_still():
    history = {f"boundary0_{k}_m": np.zeros(2) for k in "xyz"}
    history |= {f"boundary0_f{k}_N": np.array([0.0, 2.0 * (k == "z")]) for k in "xyz"}
    displacement, force = plot.stroke(history, 0)
    np.testing.assert_array_equal(displacement, 0)
    np.testing.assert_array_equal(force, [0, 2])


def test_piston_draws_force_against_displacement_and_time(sim, tmp_path):
    figure = plot.piston(record(sim, tmp_path))
    labels = [(axes.get_xlabel(), axes.get_ylabel()) for axes in figure.axes]
    assert labels == [
        ("displacement (µm)", "resisting force (mN)"),
        ("", "force (mN)"),
        ("time (µs)", "displacement (µm)"),
    ]
    loop = figure.axes[0].lines[0]
    np.testing.assert_allclose(loop.get_ydata(), loop.get_xdata(), atol=1e-9)  # 1 mN per µm


def test_piston_needs_a_piston():
    with pytest.raises(ValueError, match="no piston"):
        plot.piston({"time_s": np.arange(3.0), "boundary0_fx_N": np.zeros(3)})


# Folders


def test_draw_makes_every_picture(sim, tmp_path):
    drawn = plot.draw(record(sim, tmp_path))
    names = ["overview.png", "depression.png", "bed.png", "energy.png", "piston.png"]
    assert [path.name for path in drawn] == names
    for path in drawn:
        assert path.read_bytes().startswith(b"\x89PNG")
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(
        [*names, "history.csv", "state.npz"]
    )


def test_draw_makes_what_the_files_allow(tmp_path):
    record(FakeSimulation(*layer(4), substrate=False, boundaries=[
        box((-1, -1, -1), (1, 1, 1)), plane((0, 0, 4e-3), (0, 0, -1)),
    ]), tmp_path)  # fmt: skip
    assert [path.name for path in plot.draw(tmp_path)] == ["bed.png", "energy.png"]
    (tmp_path / "state.npz").unlink()
    assert [path.name for path in plot.draw(str(tmp_path))] == ["energy.png"]


def test_draw_refuses_a_folder_of_something_else(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"neither state\.npz nor history\.csv"):
        plot.draw(tmp_path)


def test_pictures_need_no_pyplot_and_outputs_no_matplotlib():
    code = (
        "import sys, numpy, taichi_dem.output, taichi_dem.plot\n"
        "heavy = {'matplotlib', 'vtkmodules', 'tqdm'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
        "taichi_dem.plot.energy({'time_s': numpy.arange(2), 'kinetic_J': numpy.arange(2)})\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
