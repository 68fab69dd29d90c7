"""What a run leaves on disk: exact, complete at any moment, readable by others."""

import csv
import io
import json
import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from fake_simulation import FakeSimulation, box, layer, plane

from taichi_dem.output import (
    Frames,
    History,
    Progress,
    State,
    Summary,
    read_history,
)
from taichi_dem.snapshot import Snapshot
from taichi_dem.validation import InputError
from taichi_dem.writing import write_text


@pytest.fixture
def sim():
    walls = [box((-1, -1, -np.inf), (1, 1, np.inf)), plane((0, 0, 3e-3), (0, 0, -1), "Piston")]
    return FakeSimulation(*layer(16), boundaries=walls)


def run(sim, output, writes, steps=1):
    """Start, write at the present step and at ``writes`` - 1 later ones; not finished."""
    output.start(sim)
    for k in range(writes):
        if k:
            sim.advance(steps)
        output.write(sim)


# History


def test_history_keeps_every_digit(sim, tmp_path):
    sim.dt = 1 / 3e5
    run(sim, History(tmp_path, every=1e-5), writes=4)
    history = read_history(tmp_path)
    assert history["time_s"].tolist() == [k * sim.dt for k in range(4)]
    assert history["step"].tolist() == [0, 1, 2, 3]
    assert history["kinetic_J"][0] == sim.energy()["kinetic"]
    assert history["balance_error_J"][0] == sim.energy()["balance_error"]
    assert history["substrate_force_N"][0] == sim.substrate.force.sum()
    assert history["coordination"][0] == sim.coordination()
    assert history["largest_overlap"][0] == sim.largest_overlap()


def test_history_has_forces_of_boundaries_and_motion_of_pistons(sim, tmp_path):
    sim.boundaries[0].force[:] = 1, 2, 3
    sim.boundaries[1].force[:] = 4, 5, 6
    sim.boundaries[1].velocity[:] = 0, 0, -0.5
    run(sim, History(tmp_path, every=1e-5), writes=1)
    history = read_history(tmp_path)
    assert [history[f"boundary0_f{k}_N"][0] for k in "xyz"] == [1, 2, 3]
    assert [history[f"boundary1_f{k}_N"][0] for k in "xyz"] == [4, 5, 6]
    assert history["boundary1_z_m"][0] == 3e-3
    assert history["boundary1_vz_m_per_s"][0] == -0.5
    assert "boundary0_x_m" not in history


def test_history_without_substrate_or_some_energies(tmp_path):
    sim = FakeSimulation(*layer(4), substrate=False)
    sim.energy = lambda: {"kinetic": 1.0}
    run(sim, History(tmp_path, every=1), writes=1)
    assert set(read_history(tmp_path)) == {
        "time_s", "step", "kinetic_J", "coordination", "largest_overlap",
    }  # fmt: skip


def test_history_can_be_read_after_every_write(sim, tmp_path):
    history = History(tmp_path, every=1e-5)
    history.start(sim)
    assert len(read_history(tmp_path)["time_s"]) == 0
    for k in range(3):
        history.write(sim)
        assert len(read_history(tmp_path)["time_s"]) == k + 1
        sim.advance()


def test_history_ends_with_the_last_state_once(sim, tmp_path):
    history = History(tmp_path, every=1e-5)
    run(sim, history, writes=2)
    history.finish(sim)
    assert read_history(tmp_path)["step"].tolist() == [0, 1]
    history.start(sim)
    sim.advance(5)
    history.finish(sim)
    history.finish(sim)
    assert read_history(tmp_path)["step"].tolist() == [0, 1, 6]


def test_history_leaves_out_a_line_cut_short(sim, tmp_path):
    run(sim, History(tmp_path, every=1e-5), writes=3)
    path = tmp_path / "history.csv"
    path.write_text(path.read_text()[:-5])
    assert read_history(tmp_path)["step"].tolist() == [0, 1]


def test_history_goes_on_from_a_checkpoint(sim, tmp_path):
    run(sim, History(tmp_path, every=1e-5), writes=5)
    before = (tmp_path / "history.csv").read_text().splitlines()
    sim.steps, sim.time = 2, 2 * sim.dt
    run(sim, History(tmp_path, every=1e-5), writes=2)
    after = (tmp_path / "history.csv").read_text().splitlines()
    assert after == before[:5]  # header, steps 0 to 2, and step 3 computed again


def test_history_of_a_fresh_run_replaces_the_old_one(sim, tmp_path):
    run(sim, History(tmp_path, every=1e-5), writes=5)
    sim.steps, sim.time = 0, 0.0
    run(sim, History(tmp_path, every=1e-5), writes=2)
    assert read_history(tmp_path)["step"].tolist() == [0, 1]


def test_history_refuses_to_go_on_with_other_columns(sim, tmp_path):
    run(sim, History(tmp_path, every=1e-5), writes=2)
    sim.energy = lambda: {"kinetic": 1.0}
    with pytest.raises(InputError, match=r"history\.csv.*other columns.*choose another folder"):
        History(tmp_path, every=1e-5).start(sim)
    assert len(read_history(tmp_path)["step"]) == 2


def test_history_is_plain_csv(sim, tmp_path):
    run(sim, History(tmp_path, every=1e-5), writes=2)
    with (tmp_path / "history.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0][:2] == ["time_s", "step"]
    assert rows[2][:2] == [repr(sim.dt), "1"]


@pytest.mark.parametrize("output", [History, Frames, State, Summary])
@pytest.mark.parametrize("every", [0, -1.0, float("nan"), "1"])
def test_interval_must_be_positive(output, every, tmp_path):
    with pytest.raises(InputError, match=rf"{output.__name__}\.every = .*> 0 s"):
        output(tmp_path, every=every)


@pytest.mark.parametrize("points", [1, 1.5, True])
def test_substrate_points_must_make_a_grid(points, tmp_path):
    with pytest.raises(InputError, match=r"substrate_points = .*>= 2"):
        Frames(tmp_path, every=1, substrate_points=points)


# Snapshot


def test_grid_is_square_and_covers_every_dent(sim):
    state = Snapshot.of(sim, substrate_points=65)
    assert max(state.depression.shape) == 65
    assert np.ptp(np.diff(state.grid_x)) < 1e-9 * np.ptp(state.grid_x)
    assert np.diff(state.grid_x)[0] == pytest.approx(np.diff(state.grid_y)[0])
    low = (state.substrate_position - state.substrate_radius[:, None]).min(axis=0)
    high = (state.substrate_position + state.substrate_radius[:, None]).max(axis=0)
    assert state.grid_x[0] < low[0] and high[0] < state.grid_x[-1]
    assert state.grid_y[0] < low[1] and high[1] < state.grid_y[-1]


def test_grid_grows_to_cover_and_then_stays(sim):
    first = Snapshot.of(sim)
    cover = np.array([[first.grid_x[0], first.grid_y[0]], [first.grid_x[-1], first.grid_y[-1]]])
    again = Snapshot.of(sim, cover=cover)
    np.testing.assert_allclose(again.grid_x, first.grid_x, rtol=1e-12)
    np.testing.assert_allclose(again.grid_y, first.grid_y, rtol=1e-12)
    wider = Snapshot.of(sim, cover=2 * cover)
    assert wider.grid_x[-1] >= 2 * first.grid_x[-1]


def test_depression_on_the_grid_is_the_substrates_own(sim):
    state = Snapshot.of(sim, substrate_points=17)
    row, column = 5, 11
    point = np.array([[state.grid_x[column], state.grid_y[row]]])
    assert state.depression[row, column] == sim.substrate.field(point)[0] > 0


def test_line_of_a_contact_takes_the_short_way_round_a_periodic_cell():
    x = np.array([[0.05e-3, 1e-3, 5e-3], [9.95e-3, 1e-3, 5e-3]])
    sim = FakeSimulation(x, [0.2e-3, 0.2e-3], substrate=False)
    sim.scene.period = (10e-3, 10e-3)
    contact = np.zeros(1, sim.contacts().dtype)
    contact["i"], contact["j"] = 0, 1
    sim.contacts = lambda: contact
    start, end = Snapshot.of(sim).contact_ends()[0]
    np.testing.assert_allclose(end - start, [-0.1e-3, 0, 0], atol=1e-12)


def test_coordination_adds_up_to_the_ends_of_contacts(sim):
    state = Snapshot.of(sim)
    between = np.count_nonzero(state.contact_j >= 0)
    outside = np.count_nonzero(state.contact_j < 0)
    assert between > 0 and outside == 16
    assert state.coordination.sum() == 2 * between + outside


def test_state_survives_the_disk(sim, tmp_path):
    state = State(tmp_path, every=1e-5)
    run(sim, state, writes=2)
    read, live = Snapshot.load(tmp_path), Snapshot.of(sim)
    for name, value in vars(live).items():
        np.testing.assert_array_equal(getattr(read, name), value)
    sim.advance()
    state.finish(sim)
    assert Snapshot.load(tmp_path).step == 2
    assert [path.name for path in tmp_path.iterdir()] == ["state.npz"]


def test_a_failed_write_leaves_the_old_state(sim, tmp_path, monkeypatch):
    state = State(tmp_path, every=1e-5)
    run(sim, state, writes=1)
    sim.advance()

    def fail(*args, **kwargs):
        raise OSError("no space left on device")

    monkeypatch.setattr(np, "savez", fail)
    with pytest.raises(OSError, match="no space"):
        state.write(sim)
    assert Snapshot.load(tmp_path).step == 0
    assert [path.name for path in tmp_path.iterdir()] == ["state.npz"]


def test_what_is_no_plain_file_is_written_and_not_replaced(tmp_path):
    os.mkfifo(pipe := tmp_path / "pipe")
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_text(pipe, "said")
    assert os.read(reader, 10) == b"said" and pipe.is_fifo()
    os.close(reader)
    with pytest.raises(IsADirectoryError):
        write_text(tmp_path, "said")
    assert list(tmp_path.iterdir()) == [pipe]


# Frames


def read_vtk(path):
    """The data set in an XML file of VTK and its point, cell and field arrays."""
    pytest.importorskip("vtkmodules")
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLStructuredGridReader

    reader = {".vtp": vtkXMLPolyDataReader, ".vts": vtkXMLStructuredGridReader}[path.suffix]()
    reader.SetFileName(str(path))
    reader.Update()
    data = reader.GetOutput()
    arrays = {
        source.GetArrayName(k): vtk_to_numpy(source.GetArray(k))
        for source in (data.GetPointData(), data.GetCellData(), data.GetFieldData())
        for k in range(source.GetNumberOfArrays())
    }
    points = data.GetPoints()
    arrays["points"] = vtk_to_numpy(points.GetData()) if points else np.empty((0, 3))
    return data, arrays


def test_frames_hold_the_spheres(sim, tmp_path):
    pytest.importorskip("vtkmodules")
    sim.advance(3)
    run(sim, Frames(tmp_path, every=1e-3), writes=1)
    data, arrays = read_vtk(tmp_path / "frames/spheres_000000.vtp")
    assert data.GetNumberOfVerts() == 16
    np.testing.assert_array_equal(arrays["points"], sim.particles.position)
    for name in ("radius", "velocity", "omega", "force", "material"):
        np.testing.assert_array_equal(arrays[name], getattr(sim.particles, name))
    np.testing.assert_array_equal(arrays["coordination"], Snapshot.of(sim).coordination)
    np.testing.assert_array_equal(arrays["id"], np.arange(16))
    assert "asleep" not in arrays
    assert arrays["TimeValue"] == [3 * sim.dt] and arrays["step"] == [3]


def test_frames_say_who_sleeps_where_somebody_may(sim, tmp_path):
    pytest.importorskip("vtkmodules")
    sim.scene.sleep, sim.asleep = True, np.arange(16) % 3 == 0
    run(sim, Frames(tmp_path, every=1e-3), writes=1)
    asleep = read_vtk(tmp_path / "frames/spheres_000000.vtp")[1]["asleep"]
    assert asleep.dtype == np.int32
    np.testing.assert_array_equal(asleep, sim.asleep)


def test_frames_hold_the_contacts_as_lines(sim, tmp_path):
    pytest.importorskip("vtkmodules")
    run(sim, Frames(tmp_path, every=1e-3), writes=1)
    data, arrays = read_vtk(tmp_path / "frames/contacts_000000.vtp")
    contacts, x = sim.contacts(), sim.particles.position
    assert data.GetNumberOfLines() == len(contacts)
    ends = arrays["points"].reshape(-1, 2, 3)
    pair = contacts["j"] >= 0
    np.testing.assert_array_equal(ends[:, 0], x[contacts["i"]])
    np.testing.assert_allclose(ends[pair, 1], x[contacts["j"][pair]], rtol=1e-12)
    np.testing.assert_array_equal(ends[~pair, 1], contacts["position"][~pair])
    np.testing.assert_array_equal(arrays["kind"], np.where(pair, 0, 2))
    np.testing.assert_array_equal(arrays["overlap"], contacts["overlap"])
    magnitude = np.linalg.norm(contacts["force"], axis=1)
    np.testing.assert_array_equal(arrays["force"], magnitude)
    np.testing.assert_allclose(arrays["normal_force"], magnitude, rtol=1e-12)


def test_frames_hold_the_dented_surface(sim, tmp_path):
    pytest.importorskip("vtkmodules")
    run(sim, Frames(tmp_path, every=1e-3, substrate_points=33), writes=1)
    data, arrays = read_vtk(tmp_path / "frames/substrate_000000.vts")
    assert max(data.GetExtent()) == 32
    assert arrays["depression"].min() > 0
    np.testing.assert_array_equal(arrays["points"][:, 2], -arrays["depression"])
    np.testing.assert_array_equal(
        sim.substrate.field(arrays["points"][:, :2]), arrays["depression"]
    )


def test_frames_form_one_series_of_three_parts(sim, tmp_path):
    pytest.importorskip("vtkmodules")
    run(sim, Frames(tmp_path, every=1e-5), writes=3)
    entries = [e.attrib for e in ElementTree.parse(tmp_path / "frames.pvd").iter("DataSet")]
    assert [e["name"] for e in entries] == ["spheres", "contacts", "substrate"] * 3
    assert [e["part"] for e in entries] == ["0", "1", "2"] * 3
    assert [float(e["timestep"]) for e in entries[::3]] == [0, sim.dt, 2 * sim.dt]
    assert all((tmp_path / e["file"]).exists() for e in entries)
    assert entries[-1]["file"] == "frames/substrate_000002.vts"
    assert len(list((tmp_path / "frames").iterdir())) == 9
    assert Snapshot.load(tmp_path).step == 2


def test_frames_go_on_from_a_checkpoint_and_forget_what_came_after(sim, tmp_path):
    pytest.importorskip("vtkmodules")
    run(sim, Frames(tmp_path, every=1e-5), writes=4)
    sim.steps, sim.time = 1, sim.dt
    frames = Frames(tmp_path, every=1e-5)
    frames.start(sim)
    names = sorted(path.name for path in (tmp_path / "frames").glob("spheres*"))
    assert names == ["spheres_000000.vtp", "spheres_000001.vtp"]
    frames.write(sim)
    sim.advance(5)
    frames.finish(sim)
    frames.finish(sim)
    index = ElementTree.parse(tmp_path / "frames.pvd")
    times = [float(e.get("timestep")) for e in index.iter("DataSet") if e.get("part") == "0"]
    assert times == [0, sim.dt, 6 * sim.dt]


@pytest.mark.parametrize("count", [0, 1])
def test_frames_without_contacts(count, tmp_path):
    pytest.importorskip("vtkmodules")
    sim = FakeSimulation(np.full((count, 3), 5e-3), np.full(count, 1e-3))
    run(sim, Frames(tmp_path, every=1e-3, substrate_points=9), writes=1)
    data, arrays = read_vtk(tmp_path / "frames/spheres_000000.vtp")
    assert data.GetNumberOfPoints() == count and len(arrays["radius"]) == count
    data, arrays = read_vtk(tmp_path / "frames/contacts_000000.vtp")
    assert data.GetNumberOfLines() == 0
    surface = tmp_path / "frames/substrate_000000.vts"
    assert surface.exists() == (count > 0)
    if count:
        _, arrays = read_vtk(surface)
        assert not arrays["depression"].any()
        assert np.ptp(arrays["points"][:, 0]) == pytest.approx(2e-3)
        assert arrays["points"][:, 0].mean() == pytest.approx(5e-3)


def test_frames_of_a_run_that_blew_up(sim, tmp_path):
    pytest.importorskip("vtkmodules")
    sim.particles.position[3] = np.nan
    sim.contacts = lambda: np.zeros(0, [("i", int), ("j", int), ("overlap", float)] + [
        (name, float, 3) for name in ("force", "position", "normal")
    ])  # fmt: skip
    run(sim, Frames(tmp_path, every=1e-3), writes=1)
    _, arrays = read_vtk(tmp_path / "frames/spheres_000000.vtp")
    assert np.isnan(arrays["points"]).any(axis=1).tolist() == [k == 3 for k in range(16)]


def test_frames_say_what_to_install(sim, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "vtkmodules.vtkIOXML", None)
    with pytest.raises(ImportError, match=r"pip install 'taichi-dem\[view\]'"):
        Frames(tmp_path, every=1e-3).start(sim)


# Summary


def summary_of(folder):
    def refuse(constant):
        raise ValueError(f"{constant} is not JSON")

    return json.loads((folder / "summary.json").read_text(), parse_constant=refuse)


def test_summary_says_how_fast_and_how_it_ended(sim, tmp_path):
    sim.dt_reason, sim.warnings = "glass on gel", {"large overlap": 2}
    summary = Summary(tmp_path)
    assert summary.every is None
    summary.start(sim)
    assert summary_of(tmp_path)["outcome"] == "running"
    assert (tmp_path / "scene.toml").exists()
    sim.advance(100)
    summary.finish(sim)
    read = summary_of(tmp_path)
    assert read["outcome"] == "finished"
    assert read["steps"] == read["steps_this_run"] == 100
    assert read["simulated_time_s"] == 100 * sim.dt
    assert read["steps_per_second"] * read["wall_time_s"] == pytest.approx(100)
    assert read["particle_steps_per_second"] == pytest.approx(16 * read["steps_per_second"])
    assert (read["dt_s"], read["dt_reason"]) == (sim.dt, "glass on gel")
    assert read["energy_J"] == sim.energy()
    assert read["warnings"] == {"large overlap": 2}
    assert read["version"]


def test_summary_counts_the_speed_of_this_run_only(sim, tmp_path):
    sim.advance(1000)
    summary = Summary(tmp_path)
    summary.start(sim)
    sim.advance(10)
    summary.finish(sim)
    assert summary_of(tmp_path)["steps"] == 1010
    assert summary_of(tmp_path)["steps_this_run"] == 10


def test_summary_adds_what_the_simulation_says(sim, tmp_path):
    sim.summary = lambda: {"outcome": "stopped: settled", "rebuilds": np.int64(3)}
    sim.energy = lambda: {"kinetic": float("nan")}
    summary = Summary(tmp_path)
    summary.start(sim)
    summary.finish(sim)
    read = summary_of(tmp_path)
    assert (read["outcome"], read["rebuilds"]) == ("stopped: settled", 3)
    assert read["energy_J"] == {"kinetic": "nan"}


@pytest.mark.parametrize("output", [History, State, Summary])
def test_finish_without_start_does_nothing(output, sim, tmp_path):
    output(tmp_path, every=1.0).finish(sim)
    Frames(tmp_path, every=1.0).finish(sim)
    Progress(1.0).finish(sim)
    assert not list(tmp_path.iterdir())


# All together

ENDLESS = """
import sys
from fake_simulation import FakeSimulation, layer
from taichi_dem.output import Frames, History, Summary

sim = FakeSimulation(*layer(16))
outputs = [History(sys.argv[1], 1e-5), Frames(sys.argv[1], 1e-5, 9), Summary(sys.argv[1], 1e-5)]
for output in outputs:
    output.start(sim)
while True:
    for output in outputs:
        output.write(sim)
    sim.advance()
    if sim.steps == 5:
        print("five", flush=True)
"""


def test_a_killed_run_leaves_a_readable_folder(tmp_path):
    pytest.importorskip("vtkmodules")
    command = [sys.executable, "-c", ENDLESS, str(tmp_path)]
    here = Path(__file__).parent
    search = os.pathsep.join([str(here), str(here.parents[1]), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"PYTHONPATH": search}
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment) as process:
        assert process.stdout.readline() == b"five\n"
        process.kill()
    steps = read_history(tmp_path)["step"]
    assert len(steps) >= 5
    assert steps.tolist() == list(range(len(steps)))
    files = [e.get("file") for e in ElementTree.parse(tmp_path / "frames.pvd").iter("DataSet")]
    assert len(files) >= 15
    for file in files:
        _, arrays = read_vtk(tmp_path / file)
        assert len(arrays["points"]) > 0
    assert Snapshot.load(tmp_path).step >= 4
    assert summary_of(tmp_path)["outcome"] == "running"
    assert summary_of(tmp_path)["steps"] >= 4


# Progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_progress_draws_a_bar_on_a_terminal(sim):
    stream = Terminal()
    progress = Progress(total_time=1e-3, stream=stream)
    assert progress.every < 1e-3
    run(sim, progress, writes=11, steps=10)
    progress.finish(sim)
    last = stream.getvalue().rstrip().split("\r")[-1]
    assert "100%" in last and "t = 0.001 of 0.001 s" in last and "steps/s" in last


def test_progress_is_quiet_elsewhere(sim, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr("taichi_dem.progress.time.perf_counter", lambda: clock[0])
    stream = io.StringIO()
    progress = Progress(total_time=1e-3, stream=stream)
    progress.start(sim)
    for _ in range(50):
        progress.write(sim)
        sim.advance()
        clock[0] += 0.5
    lines = stream.getvalue().splitlines()
    assert len(lines) == 2
    assert lines[0] == "t = 0.0002 of 0.001 s, 2 steps/s, 00:40 left"
    progress.finish(sim)
    assert stream.getvalue().splitlines()[-1] == "t = 0.0005 of 0.001 s, 2 steps/s, 00:25 left"


def test_progress_of_a_short_run_prints_nothing_to_a_file(sim):
    stream = io.StringIO()
    progress = Progress(total_time=1e-4, stream=stream)
    run(sim, progress, writes=11)
    progress.finish(sim)
    assert stream.getvalue() == ""


def test_progress_goes_on_from_a_checkpoint(sim):
    sim.advance(100)
    stream = Terminal()
    progress = Progress(total_time=1e-3, stream=stream)
    run(sim, progress, writes=2, steps=50)
    progress.finish(sim)
    last = stream.getvalue().rstrip().split("\r")[-1]
    assert " 50%" in last and "t = 0.0015 of 0.002 s" in last


def test_progress_needs_a_positive_time():
    with pytest.raises(InputError, match=r"Progress\.total_time = -1"):
        Progress(-1)
