"""Frames for ParaView: spheres, contacts and the substrate's surface as one series in time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np

from taichi_dem.snapshot import FILE, Snapshot
from taichi_dem.writing import check_every, check_points, replacing, write_text

INDEX = "frames.pvd"
PARTS = ("spheres", "contacts", "substrate")
SPHERE, BOUNDARY, SUBSTRATE = 0, 1, 2  # the values of the contacts' array "kind"


class Frames:
    """VTK files in ``folder/frames``, opened together through ``folder/frames.pvd``.

    The spheres are points with radius (m), velocity (m/s), omega (rad/s), force (N), coordination,
    material, id and, in a scene with ``sleep``, asleep (0, 1); the contacts are lines with force
    (N, magnitude), normal_force (N), overlap (m), kind (0 between spheres, 1 boundary,
    2 substrate), i, j; the substrate is a surface with depression (m). ``substrate_points``: points
    along the longer side of its grid, which follows the dents and never shrinks during a run. The
    last state is also kept in ``state.npz``.
    """

    def __init__(self, folder: Path | str, every: float, substrate_points: int = 129):
        self.folder = Path(folder)
        self.every = check_every(self, every)
        self.substrate_points = check_points(self, substrate_points)
        self._frames: dict[float, list[str]] = {}  # files of each frame, by time
        self._cover: np.ndarray | None = None
        self._started = False

    def start(self, sim: Any) -> None:
        """Prepare the folder; ImportError if the vtk library is missing."""
        _vtk()
        (self.folder / "frames").mkdir(parents=True, exist_ok=True)
        earlier = read_index(self.folder)
        self._frames = {t: earlier[t] for t in earlier if sim.steps > 0 and t <= sim.time}
        self._cover = None
        self._started = True
        self._save_index()
        for time in earlier.keys() - self._frames.keys():
            for file in earlier[time]:
                (self.folder / file).unlink(missing_ok=True)

    def write(self, sim: Any) -> None:
        if sim.time in self._frames:
            return
        state = Snapshot.of(sim, self.substrate_points, self._cover)
        parts = {"spheres": spheres(state), "contacts": contacts(state)}
        if sim.scene.sleep:
            asleep = {"asleep": np.asarray(sim.asleep, dtype=np.int32)}
            _attach(parts["spheres"].GetPointData(), asleep)
        if state.has_substrate:
            self._cover = np.array([[g[0], g[-1]] for g in (state.grid_x, state.grid_y)]).T
            parts["substrate"] = surface(state)
        files = []
        for part, data in parts.items():
            suffix = "vts" if part == "substrate" else "vtp"
            files.append(f"frames/{part}_{len(self._frames):06d}.{suffix}")
            _save(data, self.folder / files[-1], state)
        self._frames[state.time] = files
        self._save_index()
        state.save(self.folder / FILE)

    def finish(self, sim: Any) -> None:
        """Add the last state if it is not there yet."""
        if self._started:
            self.write(sim)

    def _save_index(self) -> None:
        root = ElementTree.Element("VTKFile", type="Collection", version="1.0")
        collection = ElementTree.SubElement(root, "Collection")
        for time, files in self._frames.items():
            for file in files:
                part = Path(file).name.partition("_")[0]
                number = str(PARTS.index(part))
                entry = {"timestep": repr(time), "part": number, "name": part, "file": file}
                ElementTree.SubElement(collection, "DataSet", entry)
        ElementTree.indent(root)
        write_text(self.folder / INDEX, ElementTree.tostring(root, encoding="unicode") + "\n")


def read_index(folder: Path | str) -> dict[float, list[str]]:
    """Files of each frame, relative to ``folder``, by time in s; empty if there is no index. What
    the index names elsewhere than among the frames is left out."""
    index: dict[float, list[str]] = {}
    if (path := Path(folder) / INDEX).exists():
        for entry in ElementTree.parse(path).iter("DataSet"):
            if Path(file := entry.get("file", "")).parent == Path("frames"):
                index.setdefault(float(entry.get("timestep", "nan")), []).append(file)
    return index


def spheres(state: Snapshot) -> Any:
    """The spheres as a vtkPolyData of points, scaled and coloured by their arrays."""
    vtk, n = _vtk(), len(state.radius)
    data = vtk.PolyData()
    data.SetPoints(_points(state.position))
    data.SetVerts(_cells(np.arange(n), 1))
    arrays = {
        "radius": state.radius,
        "velocity": state.velocity,
        "omega": state.omega,
        "force": state.force,
        "coordination": state.coordination,
        "material": state.material,
        "id": np.arange(n),
    }
    _attach(data.GetPointData(), arrays)
    return data


def contacts(state: Snapshot) -> Any:
    """The contacts as a vtkPolyData of lines."""
    vtk, c = _vtk(), len(state.contact_i)
    data = vtk.PolyData()
    data.SetPoints(_points(state.contact_ends().reshape(-1, 3)))
    data.SetLines(_cells(np.arange(2 * c), 2))
    j = state.contact_j
    arrays = {
        "force": np.linalg.norm(state.contact_force, axis=1),
        "normal_force": state.normal_force,
        "overlap": state.contact_overlap,
        "kind": np.select([j >= 0, j == -1], [SPHERE, SUBSTRATE], BOUNDARY),
        "i": state.contact_i,
        "j": j,
    }
    _attach(data.GetCellData(), arrays)
    return data


def surface(state: Snapshot) -> Any:
    """The substrate's surface as a vtkStructuredGrid at z = -depression."""
    x, y = np.meshgrid(state.grid_x, state.grid_y)
    data = _vtk().StructuredGrid()
    data.SetDimensions(len(state.grid_x), len(state.grid_y), 1)
    data.SetPoints(_points(np.stack([x, y, -state.depression], axis=-1).reshape(-1, 3)))
    _attach(data.GetPointData(), {"depression": state.depression.ravel()})
    return data


def _vtk() -> SimpleNamespace:
    """The parts of vtk that are used; imported late, since that takes a third of a second."""
    try:
        from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
        from vtkmodules.vtkCommonCore import vtkPoints
        from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData, vtkStructuredGrid
        from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLStructuredGridWriter
    except ImportError as error:
        raise ImportError("Frames needs the vtk library: pip install 'taichi-dem[view]'") from error
    return SimpleNamespace(
        array=numpy_to_vtk,
        ids=numpy_to_vtkIdTypeArray,
        Points=vtkPoints,
        CellArray=vtkCellArray,
        PolyData=vtkPolyData,
        StructuredGrid=vtkStructuredGrid,
        writers={"vtp": vtkXMLPolyDataWriter, "vts": vtkXMLStructuredGridWriter},
    )


def _array(values: Any, name: str = "") -> Any:
    array = _vtk().array(np.ascontiguousarray(values), deep=True)
    array.SetName(name)
    return array


def _points(position: np.ndarray) -> Any:
    points = _vtk().Points()
    points.SetData(_array(position.astype(float)))
    return points


def _cells(ends: np.ndarray, size: int) -> Any:
    """Cells of ``size`` points each; ``ends`` lists the points of one after another."""
    vtk = _vtk()
    offsets = np.arange(0, len(ends) + 1, size, dtype=np.int64)
    cells = vtk.CellArray()
    cells.SetData(vtk.ids(offsets, deep=True), vtk.ids(ends.astype(np.int64), deep=True))
    return cells


def _attach(target: Any, arrays: Mapping[str, np.ndarray]) -> None:
    for name, values in arrays.items():
        whole = np.issubdtype(values.dtype, np.integer)
        target.AddArray(_array(values.astype(np.int32 if whole else float), name))


def _save(data: Any, path: Path, state: Snapshot) -> None:
    """Write compressed binary, with the time where readers look for it; OSError if it fails."""
    data.GetFieldData().AddArray(_array([state.time], "TimeValue"))
    data.GetFieldData().AddArray(_array([state.step], "step"))
    writer = _vtk().writers[path.suffix[1:]]()
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()
    writer.SetCompressorTypeToZLib()
    writer.SetCompressionLevel(1)
    writer.SetInputData(data)
    with replacing(path) as temporary:
        writer.SetFileName(str(temporary))
        if not writer.Write() or writer.GetErrorCode():
            raise OSError(f"{path} could not be written; is the disk full?")
